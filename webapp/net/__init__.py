"""The only code that talks to other hosts: the map tile services that are configured, and no others."""
