"""The only code that talks to other hosts: configured map tile services, and where weights come from."""
