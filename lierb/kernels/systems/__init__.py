"""Systems of one body and of mechanisms: plan, state, inputs, rates, measures and stabilisation."""
