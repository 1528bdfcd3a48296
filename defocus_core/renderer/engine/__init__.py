"""A picture through the pipeline: preparation, regions, layer order, and hidden surfaces.

frame: the whole picture, and what all its regions share.
region: a rectangle of tiles that is computed at once; tile: a square that is composited at once.
surface: visible pixels, or hidden ones that are known or invented.
slice: the pixels of a surface whose radii are near a slice radius, blurred by one kernel.
layer: neighbouring slices, which add up; layers occlude each other.
octave: the layers of a hidden surface whose radii differ by less than a factor of two.
part: a part of the aperture: first those of the centre view, then those of left and right.
coarse pixel: two by two px, a pixel of reduced resolution.
"""
