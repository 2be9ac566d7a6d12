"""Predict and compare methods: completion groups, orders of convergence, the paper's section 5."""
