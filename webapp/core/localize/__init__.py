"""The methods: `vote` (the thesis of 2013, exactly), `verified` (ours), and `thorough` (with a network's matches)."""
