"""The methods: `vote` (the thesis of 2013, exactly) and `verified` (ours)."""
