"""Files of pictures: EXR, raster, float maps, bare arrays, colour, kinds of output."""
