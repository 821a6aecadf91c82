"""The files of an index, of calibrations and of evaluations."""
