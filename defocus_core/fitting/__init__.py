"""The lens that explains a pair of pictures: radii k (d₀ - d), with strength k and focus d₀.

Radii are affine in disparity d.
"""
