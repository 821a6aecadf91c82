"""`expmap cluster demo`: all parts of several machines, on one, to try them and to kill them."""
