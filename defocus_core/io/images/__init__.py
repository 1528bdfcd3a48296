"""Files of pictures: EXR layers, raster, float maps, bare arrays, colour, kinds of output.

A part: one picture of an EXR file; a page: one of a TIFF. A layer: the channels of one colour. A
strip: rows that are decoded or encoded at once. Linear: proportional to light; else sRGB-encoded.
A map: one channel of float32, without colour.
"""
