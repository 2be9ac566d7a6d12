"""Users' functions are checked, and traced or called lane by lane."""
