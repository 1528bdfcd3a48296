"""Depth of a picture on its way to the renderer: resized, checked, focused on, repaired, converted.

Radii are signed, in px: negative nearer than the focus.
"""
