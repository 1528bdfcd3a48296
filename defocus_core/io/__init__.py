"""Files of pictures and depth, in and out: no lens and no rendering.

OpenEXR, raster images, depth formats, arrays in files, frame patterns, metadata.
"""
