"""Read MJCF and URDF files."""
