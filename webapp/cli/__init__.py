"""The command line: arguments to tasks to text.

Results go to standard output, progress and messages to standard error.
"""
