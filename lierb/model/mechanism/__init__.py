"""Mechanisms: links, tree, coordinates, closing of loops, and their rows."""
