"""What is asked for: jobs, jobs files, lenses, options, sweeps, shots, kinds of output.

Terms: a picture is colour and depth, with a hidden layer if there is one. A job is one picture, one
lens and its outputs. A sample is what a job writes; its name is that of the picture and a suffix
for the lens. A point is one lens of a sweep; a draw is one random lens.
"""
