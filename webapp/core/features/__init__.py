"""Local features of photos, and global descriptors.

`table.py` lists the detectors, extractors and matchers that can be chosen; there is a file for each
extractor. `lightglue.py` matches the features of two photos.
"""
