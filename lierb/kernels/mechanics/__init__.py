"""A body, its constraints and forces, and its equations of motion."""
