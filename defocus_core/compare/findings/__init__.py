"""The causes of differences, found from pixels: explanations, causes, findings.

Terms: A is the reference and B is the picture to judge. An explanation predicts B from A; the
explanation whose residual is much smaller than those of its rivals is the cause. A finding is the
name of a cause, with its numbers.

Causes are rows of `table`. Their models are in `tone` (values in place), `geometry` (places),
`softness` (sharpness) and `traces` (patterns); `choice` tries the models.
"""
