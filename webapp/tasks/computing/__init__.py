"""Parallel computing: in this process, in processes of this machine, or on Dask workers."""
