"""A batch: jobs, lenses, journal, workers, one job from files to files, data sets."""
