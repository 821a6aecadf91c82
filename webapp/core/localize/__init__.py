"""The methods: `vote` (the thesis of 2013, exactly), `verified` (ours), `thorough` (with a network)."""
