"""Depth files of data sets, renderers, networks and phones, decoded to planar metres.

Numbers: the values in the file. Depth: planar distance along the axis. Distance: to the point.
Disparity: 1 / depth, or px between two cameras. Sky: infinitely far. Invalid: without any depth. A
format: a row of the table, which says how numbers become depth. A sidecar: a file beside the depth
file that holds a part of this rule.
"""
