"""The study file: its tables, checks, sources, units and changes."""
