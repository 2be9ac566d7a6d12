"""Steps: clocks, the stepper of all methods, and the choice of adaptive steps."""
