"""Comparison of pictures: what differs, by how much, and whether that is allowed.

Terms: A is the reference and B is what is judged. A pair is a file of A and the file of B with the
same name. A metric is a number of a pair, a rule is a threshold on a metric. A note is a difference
that changes no pixel. Findings are those of `defocus_core.compare.findings`.
"""
