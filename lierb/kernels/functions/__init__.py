"""Users' functions: checked, traced, or called lane by lane."""
