"""Batches: many jobs carried out by several workers, a journal of the results, and data sets."""
