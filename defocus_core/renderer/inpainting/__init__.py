"""Content hidden by a nearer surface: its place, colour and radius where the lens sees it.

hidden: not visible through a pinhole, but through a part of the aperture.
revealed: hidden, and visible through the aperture behind a depth edge.
known: given by the caller as a second layer. Hidden content that is not known is invented.
continued: taken smoothly from farther surfaces around; transported: taken along a line.
coarse pixel: a pixel of reduced resolution, two by two pixels of the next finer level.
sheet: one surface in each coarse pixel of a level. A level has two sheets where a coarse pixel
holds an edge.
border: the radius that a surface must exceed to be continued behind a nearer one.
"""
