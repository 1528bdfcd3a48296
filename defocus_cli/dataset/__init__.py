"""A finished batch as a dataset: index, shards, samples."""
