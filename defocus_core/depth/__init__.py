"""Depth maps converted to planar depth, resized to their pictures, repaired before rendering.

The repair removes noise, and mends anti-aliased, soft, ramped and quantised depth.

step: the difference of radii of two neighbours. hard edge: one step between two level surfaces.
ramp: several steps of one direction. soft edge: a ramp several px wide and long.
average: a pixel of an edge that holds the mean depth of both surfaces, in distance or disparity.
level: one of few values of a quantised depth map. terrace: neighbours of one level.
silhouette: the pixels on the nearer side of edges. profile: the colours across a silhouette.
displacement: px by which an edge of depth lies outside that of the colours; negative inside.
band: rows of a frame that are examined at once. coarse pixel: a pixel of depth of another size.
"""
