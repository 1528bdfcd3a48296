"""Depth maps repaired before rendering: noise, anti-aliased, soft, ramped and quantised depth.

step: the difference of radii of two neighbours. hard edge: one step between two level surfaces.
ramp: several steps of one direction. soft edge: a ramp several px wide and long.
average: a pixel of an edge that holds the mean depth of both surfaces, in distance or disparity.
level: one of few values of a quantised depth map. terrace: neighbours of one level.
band: rows of a frame that are examined at once.
"""
