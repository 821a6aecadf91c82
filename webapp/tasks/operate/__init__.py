"""Looking after a library: backup, restore, clean-up."""
