"""Laws of the lens and their checks, error metrics, baseline renderers, cost.

A law is a statement about every picture. A check is one number that a law bounds. A probe is a
small picture, or a measurement on one, for checks. A baseline is a method to compare with.
"""
