"""Files of pictures: colour layers of EXR, raster files, colour spaces, tags, encoding.

A raster file: PNG, JPEG, TIFF and the like. A part: one picture of an EXR file; a page: one of a
TIFF. A layer: channels that together are one picture. A strip: rows that are decoded or encoded at
once. Linear: proportional to light; encoded: by a transfer function. A map: one channel of float32,
without colour.
"""
