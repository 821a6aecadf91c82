"""The methods: `vote` (the baseline, that of the thesis of 2013), `verified`, `thorough` and `landmarks`."""
