"""Files of pictures: EXR, raster, float maps, depth conventions, kinds of output."""
