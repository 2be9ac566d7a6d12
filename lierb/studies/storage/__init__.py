"""The study folder holds parts, manifest and stored files."""
