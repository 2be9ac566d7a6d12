"""Mechanisms against independent solutions: an oracle of their own and published benchmarks."""
