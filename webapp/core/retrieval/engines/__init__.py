"""Search for a query's descriptors among all descriptors of a map.

`types.py` is the interface; each engine is a file: `ivf.py` (inverted file, compressed for large maps),
`twostage.py` (one signature per photo, `vlad.py`, for maps that do not fit into memory), `flann.py` (kd-trees
or LSH), `bruteforce.py` (exact). `types.py` chooses by the available memory.
"""
