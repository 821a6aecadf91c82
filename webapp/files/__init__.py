"""One file format a module: a strict reader, a writer, and what one gives the other takes."""
