"""Search for the cause of a difference, by the pixels of a pair.

Terms: A is the reference and B is the picture to judge. An explanation is a model that predicts B
from A; its residual is the difference between prediction and B. The explanation whose residual is
much smaller than those of its rivals is the cause. A finding is the name of a cause, with numbers.

Causes are rows of `table`. Their models are in `tone` (values in place), `geometry` (places),
`softness` (sharpness) and `traces` (patterns); `choice` tries the models.
"""
