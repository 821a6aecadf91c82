"""`expmap cluster demo`: all parts of a multi-machine setup on one machine, to try out and to kill."""
