"""Pictures and reports: what the results look like to a person."""
