"""Limits of the light and the radii of a picture, and of ordinary light."""

# Greatest light of either sign: beyond it, sums over an aperture or a frame would overflow float32.
BRIGHTEST = 1e30
# Greatest radius in px: any picture is a point beside it.
GREATEST_PX = 1e8
# A highlight is brighter than this many times the brightest of all but one pixel in 200; all but
# these are ordinary.
BRIGHTER, ORDINARY = 2.0, 0.995
# Brightness as a multiple of the median, and by itself (or one divided by it), beyond which
# float32 is too coarse.
RANGE, SQUARED = 1e3, 1e15
