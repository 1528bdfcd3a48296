"""The blur that explains a picture: between a sharp and a blurred one.

The radius of the blur is affine in disparity, r = k (d₀ - d): k is the strength, in px of radius
for a disparity of 1, d₀ the disparity in focus.

unknown: a number to be found, such as the strength, the focus or the shift between two pictures.
point: a value of each unknown.
observed: the blurred pictures, one or left and right; rendered: what the renderer makes of the
sharp one; modelled: what a camera would have stored of it, to be compared with what is observed.
scale: the pictures at a smaller size.
"""
