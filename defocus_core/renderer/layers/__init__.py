"""A picture cut into layers of like blur: slice radii, sliced surfaces, slopes.

slice index: the number of a slice, by its signed blur radius.
slice: the pixels whose radii are near one slice radius, each with its share in this slice.
layer: neighbouring slices. Slices of one layer are added; layers occlude each other.
surface: a layer of the scene before it is cut into slices: what is visible, or hidden content.
sample: the colour, radius and coverage of one surface in one pixel; a stack holds the samples of
a pixel, nearest first. sample tensors: one sample of a surface per pixel. fringe: a sample list.
positions: places of radii between slice radii. `at`: rows and columns of pixels.
block: a square of 16 x 16 px in an index that says where slices have pixels.
tile: a rectangle of the result that is rendered at once. window: the larger rectangle around it
that a transform reads.
"""
