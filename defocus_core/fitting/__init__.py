"""The blur that explains a picture: between a sharp and a blurred one.

The radius of the blur is affine in disparity, r = k (d₀ - d): k is the strength, in px of radius
for a disparity of 1, d₀ the disparity in focus.
"""
