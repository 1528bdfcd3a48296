"""Comparison of pictures: what differs, by how much, why, and whether that is allowed.

Terms: A is the reference and B is what is judged. A pair is a file of A and the file of B with the
same name. A plane is one channel [H, W] of a file. A metric is a number of a pair, a rule is a
threshold on a metric. A finding is the name of a difference whose cause is known, a note is a
difference that changes no pixel.
"""
