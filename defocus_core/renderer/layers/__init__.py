"""A picture cut into layers of like blur: slice radii, sliced surfaces, slopes.

slice index: the number of a slice, by its signed blur radius.
slice: the pixels whose radii are near one slice radius, each with its share in this slice.
layer: neighbouring slices. Slices of one layer are added; layers occlude each other.
surface: a layer of the scene before it is cut into slices: what is visible, or hidden content.
sample: what one surface has in one pixel, with its coverage; a stack holds those of a pixel,
nearest first. sample tensors: those of a surface, one a pixel. fringe: a list of samples.
positions: of pixels between the radii of two slices. `at`: rows and columns of pixels.
block: a square of 16 x 16 px in an index that says where slices have pixels.
tile: a rectangle of the result that is rendered at once. window: the larger rectangle around it
that a transform reads.
"""
