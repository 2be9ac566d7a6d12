"""Predictions, completion, orders of convergence, comparison of methods, the paper's section 5."""
