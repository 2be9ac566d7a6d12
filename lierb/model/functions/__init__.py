"""Users' functions are wrenches, constraints, observables, events, states and controllers."""
