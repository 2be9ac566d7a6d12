"""Readers of MJCF and URDF files."""
