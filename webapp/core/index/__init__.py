"""Search for a query's descriptors among all descriptors of a map.

`types.py` is the interface; each engine is a file: `ivf.py` (inverted file, compressed, memory-mapped),
`flann.py` (kd-trees or LSH), `bruteforce.py` (exact).
"""
