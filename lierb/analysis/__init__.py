"""Predictions, completion groups, orders of convergence, comparisons, the paper's section 5."""
