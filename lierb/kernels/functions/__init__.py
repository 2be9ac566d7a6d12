"""Functions of the user's: checked, traced, or called lane by lane."""
