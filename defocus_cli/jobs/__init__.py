"""Jobs as they are asked for: pictures, lenses, sweeps, jobs files."""
