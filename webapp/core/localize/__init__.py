"""Localization methods: `vote` (the baseline, from a thesis of 2013), `verified`, `thorough`, `landmarks`."""
