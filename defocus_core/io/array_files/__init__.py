"""Arrays of numbers in files: NPY, PFM, NPZ, HDF5, MATLAB, rows of float32 without a header."""
