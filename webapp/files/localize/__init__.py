"""Files of indexes, calibrations and evaluations, and weights of networks."""
