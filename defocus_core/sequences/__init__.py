"""Sequences of frames: one repair for all their depth, depth averaged over time, hidden content.

frame: a picture and the signed radii of its pixels. neighbour: a frame close in time. motion: from
each pixel of a frame [2, H, W] px, right and down, to where its surface is in another frame. still:
a pixel whose surface, moved, has the same colour and depth in the other frame.
"""
