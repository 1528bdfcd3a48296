"""A batch: many jobs carried out, what was done, data sets."""
