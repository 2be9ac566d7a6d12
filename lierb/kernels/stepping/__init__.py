"""Steps: methods, clocks, and step-size control."""
