"""What happened to a picture, by the evidence of its pixels: explanations, causes, findings.

Terms: A is the reference and B is what is judged. An explanation predicts B from A; what it leaves
of the difference is measured, and the one that leaves much less than its rivals is the cause. A
finding is the name of a cause, with its numbers.

Causes are rows of `table`: `tone` (values in place), `geometry` (places), `softness` (sharpness)
and `traces` (patterns) have their models, `choice` tries them.
"""
