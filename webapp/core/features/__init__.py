"""Local features: what a photo is recognised by.

`table.py` lists what can be chosen, one file holds each extractor; `matching.py` and `geometry.py` compare
the features of two photos.
"""
