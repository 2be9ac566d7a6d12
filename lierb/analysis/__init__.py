"""Analyse methods: predictions, completion groups, orders, comparisons, the paper's section 5."""
