"""A picture divided into layers of similar blur: slice radii, sliced surfaces, slopes.

slice: the pixels whose radii are near one slice radius, each with its share in this slice.
slice index: the number of a slice, in ascending order of signed radii.
layer: neighbouring slices. Slices of one layer are added; layers occlude each other.
surface: visible or hidden content before it is divided into slices.
sample: the colour, radius and coverage of one surface in one pixel; a stack holds the samples of
a pixel, nearest first.
position: a radius as a fractional slice index. `at`: rows and columns of pixels.
block: a square of 16 x 16 px in an index of where slices have pixels.
tile: a rectangle of the result that is rendered at once. window: the larger rectangle around it
that a transform reads.
"""
