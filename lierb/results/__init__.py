"""Results of a run: Arrow tables, states, failures, figures and animations."""
