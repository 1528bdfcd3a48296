"""The record of finished jobs: journal, lock, identity, progress.

A record is a line of the journal, the outcome of one job. A stamp is size, time and hash of a
file. A run is one process that does jobs, and its plan names their files. A shard is the part of a
batch that one run does; `defocus_core.batch.datasets` has tars that are called shards, too.
"""
