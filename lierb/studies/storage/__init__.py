"""The study folder: parts, manifest and stored files."""
