"""Tables of a study's file, as pydantic models that check types and keys and make their objects."""
