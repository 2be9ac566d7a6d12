"""Mechanisms: links, tree, coordinates, closing of loops, and constraint rows."""
