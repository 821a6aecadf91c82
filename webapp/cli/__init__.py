"""The command line: commands that parse arguments, run tasks and print text.

Results go to standard output, progress and messages to standard error.
"""
