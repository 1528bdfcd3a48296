"""What is asked for: jobs, jobs files, lenses, options, sweeps, shots, kinds of output."""
