"""Depth maps: resized to their pictures, diagnosed and repaired before rendering.

The repair removes noise, and mends anti-aliased, soft, ramped and quantised depth.

step: the difference of the radii of two neighbouring pixels. hard edge: a single step between two
level surfaces.
ramp: several consecutive steps in one direction. soft edge: a ramp several px wide and long.
average: a pixel of an edge that holds the mean depth of both surfaces, in distance or disparity.
level: one of few values of a quantised depth map. terrace: neighbouring pixels of one level.
silhouette: the pixels on the nearer side of edges. profile: the line of pixels across a silhouette.
displacement: px by which an edge of depth lies outside that of the colours; negative inside.
band: rows of a frame that are examined at once. coarse pixel: a pixel of a halved resolution, or of
a depth map smaller than its picture.
"""
