"""A system, one body or a mechanism, has a plan, state, inputs, rates, measures, stabilisation."""
