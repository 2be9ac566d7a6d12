"""Compute statistics of a study's results."""
