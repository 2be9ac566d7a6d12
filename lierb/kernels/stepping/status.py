"""How a trajectory ends, as compiled code says it; `lierb.runs.failures` has the words."""

OK, SINGULAR, NON_FINITE, RAISED, MAX_STEPS, DT_MIN, EVENT = range(7)
