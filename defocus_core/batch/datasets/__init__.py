"""A finished batch as a dataset: index, Parquet table, card, shards, samples.

The index: OUT/metadata.jsonl, a line for each finished sample, its entry. A shard: here a tar of
samples, not a part of a batch. A member: a file in a tar.
"""
