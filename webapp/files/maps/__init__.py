"""The files of a map: `.cfg`, `map.json`, positions."""
