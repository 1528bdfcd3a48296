"""Depth of a picture with its lens: resized, focused on, matched to radii, doubted, converted.

Radii are signed, in px: negative nearer than the focus.
"""
