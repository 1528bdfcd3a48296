"""A finished batch as a data set: index, card, tars (here called shards), samples."""
