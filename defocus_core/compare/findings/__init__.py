"""What happened to a picture, by the evidence of its pixels: explanations, causes, findings.

Terms: A is the reference and B is what is judged. An explanation predicts B from A; the one that
leaves least of the difference is the cause. A finding is the name of a cause, with its numbers.

Causes are rows of the tables of `tone` (values in place), `geometry` (places), `softness`
(sharpness) and `traces` (patterns); their names stand in `finding`. `choice` tries them.
"""
