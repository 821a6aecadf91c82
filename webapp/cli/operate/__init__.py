"""Commands for a whole library: back up, restore, and move it to another database or storage."""
