"""Files of a library as objects in S3, with a pointer in the library's folder and a local cache."""
