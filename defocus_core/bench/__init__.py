"""Error and time of the renderer on scenes with known truth.

A shot is one lens of a scene; a method is a quality, or the baseline to compare with.
"""
