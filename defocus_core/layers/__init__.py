"""A picture cut into layers of like blur: slice ladder, sliced surfaces, slopes, matting."""
