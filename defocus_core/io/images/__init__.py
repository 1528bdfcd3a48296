"""Files of pictures: colour layers of EXR, raster files, colour spaces, tags, encoding.

A part: one picture of an EXR file; a page: one of a TIFF. A layer: channels that are one picture.
A strip: rows that are decoded or encoded at once. Linear: proportional to light; else encoded.
A map: one channel of float32, without colour.
"""
