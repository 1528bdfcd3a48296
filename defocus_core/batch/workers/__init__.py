"""Execution of jobs in chunks: by a pipeline in this process, by other processes, or by Dask."""
