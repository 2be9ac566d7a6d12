"""Arrays, memory, files, progress and optional packages: what has nothing to do with mechanics."""
