"""Steps: methods, clocks, and the choice of adaptive steps."""
