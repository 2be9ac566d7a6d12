"""Users' functions: wrenches, constraints, observables, events, states and controllers."""
