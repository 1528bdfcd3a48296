"""A finished batch as a data set: index, card, tar files (called shards here), and samples."""
