"""Tables of a study's file: pydantic models that validate them and make lierb's objects."""
