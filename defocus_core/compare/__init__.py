"""Comparison of pictures: differences, their size, and whether they are allowed.

Terms: A is the reference and B is the file to judge. A pair is a file of A and the file of B with
the same name. A metric is a number of a pair, a rule is a threshold on a metric. A note is a
difference of the files that changes no pixel. A finding is a named cause of a difference, or the
place of one without a cause.
"""
