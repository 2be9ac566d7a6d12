"""Studies: description, parts, results on the disk, and their evaluation."""
