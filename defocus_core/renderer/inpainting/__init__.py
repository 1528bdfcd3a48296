"""Content hidden by a nearer surface: its place, colour and radius where the lens sees it.

hidden: not seen through a pinhole.
revealed: hidden, and seen through a part of the aperture behind a depth edge.
known: given by the caller as a second layer. Hidden content that is not known is invented.
continued: invented smoothly from farther surfaces around; transported: invented along a line.
coarse pixel: a pixel of reduced resolution, two by two pixels of the next finer level.
border: the radius that a surface must exceed to be continued behind a nearer one.
"""
