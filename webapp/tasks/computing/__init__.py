"""Work in many parts: in this process, in processes of this machine, or on workers of Dask."""
