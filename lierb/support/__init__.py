"""Handle arrays, memory, files, progress and optional packages, without mechanics."""
