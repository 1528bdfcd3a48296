"""OpenEXR files: headers, windows, views, deep samples, reading, writing.

A part: one picture of a file. The data window: the pixels that a part holds. The display window:
the picture as it is shown. Overscan: pixels outside the display window. The frame: the display
window with the overscan that is read. Deep: with any number of samples per pixel, else flat.
"""
