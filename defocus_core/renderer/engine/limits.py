"""Limits of light and radii, tolerances, and thresholds that both backs share."""

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
# Px by which the disc that a pixel may see is enlarged: edges lie between pixels, some half a pixel
# off. Ratio between the sizes of discs that are told apart, where that is more than 1 px.
SEEN_AROUND, SEEN_RATIO = 0.7, 1.1
# Squares and crosses, in turn, whose sum is nearly a disc; True for squares. Apothem of the
# octagon, as a share of the radius of the disc.
SQUARES, APOTHEM = (True, False, False, True, False), 0.97
# Least share of the aperture that sees the frame, so that much larger discs do not divide by 0.
IN_FRAME = 0.01
# Share of the aperture that is too small to see anything through. Gap in a hidden surface that is
# an error, as a share of the coverage of the near surface; and the least gap, whose square float32
# can hold.
MIN_ROOM, GAP_ERROR, LEAST_ERROR = 1e-4, 0.2, 1e-12
# Share of its range by which detail as fine as a pixel may overshoot in a half of the lens; share
# of the least and the greatest value by which rounding may exceed them, for bounding more would
# change the energy of discs; negative light, as a share of the brightest, not worth a warning.
OVERSHOOT, SLACK, NEGLIGIBLE = 0.1, 9e-5, 1e-3
# Range of radii in px that counts as one surface in a coarse pixel of two by two pixels; the factor
# by which the range grows at each further level; and the last level has coarse pixels this many
# times as wide as the range of radii; no round number, so that rounding decides nothing.
ONE_SURFACE, GROWTH, WIDER = 1.013, 1.5, 1.99
# Greatest difference in px between the radii of neighbours at half resolution on one surface.
SAME_AT_HALF = 1.013
# Share of a pixel below which the remainder of its far surface is rounding; least weight that
# counts: it guards 0 / 0.
ROUNDED, LEAST_WEIGHT = 1.013e-3, 1e-30
# Resolutions, a quarter and less, that decide the direction of lines together.
DIRECTIONS = 3
# Distances in px from a hidden pixel, along its direction, at which a farther surface is sought.
LINE_STEPS = (2.1, 4.1, 7.1, 11.1, 16.1, 22.1)
# Greatest difference in px between the radius of a transported colour and the continued radius.
TRANSPORTED = 2.013
# Slope per px, as a share of the colour, below which a pixel has no direction; and the coherence
# below which the direction hardly counts.
NO_SLOPE, UNCLEAR = 1e-3, 0.05
# Where between the radii of the near and the far surface the border is that tells them apart. A
# surface in front of an edge may rise towards it, like the top of a box seen from above: with a
# border just above the near radius its far end would count as the hidden surface.
BORDER = 0.377
# Distance from the edge in px up to which lines are continued; weight of a surface next to a hidden
# pixel, compared with the same surface in a wider surrounding; and weight at which a pixel
# takes nothing from coarser levels.
LINES, NEXT, ENOUGH = 20.1, 4.0, 0.5
