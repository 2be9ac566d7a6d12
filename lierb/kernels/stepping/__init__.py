"""A step needs a method, a clock, and step-size control."""
