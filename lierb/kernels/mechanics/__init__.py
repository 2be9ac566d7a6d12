"""A body has constraints and forces, which enter its equations of motion."""
