"""Jobs carried out: plan, pipeline, processes, Dask.

A job is one picture taken by one lens. A chunk is a few jobs of one picture for one worker. The
coordinator is the process that sends jobs to workers, and that alone writes the journal. A shard is
the part of a batch that one coordinator does.
"""
