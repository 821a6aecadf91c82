"""Composition of the program: the pages, commands and kinds of jobs of all subpackages."""
