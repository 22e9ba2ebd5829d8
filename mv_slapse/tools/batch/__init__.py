"""The same work over many recordings, on the workers of a Dask cluster."""
