"""Files of a library that are objects in S3: a pointer in the folder, the content there, and a cache here."""
