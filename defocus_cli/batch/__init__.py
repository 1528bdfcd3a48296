"""Jobs carried out: plan, pipeline, processes, Dask."""
