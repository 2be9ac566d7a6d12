"""Studies: files, parts, results on the disk, and what is found in them."""
