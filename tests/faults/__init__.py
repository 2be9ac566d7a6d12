"""Fault campaign, its injected faults and requirements: `python -m faults` from tests/."""
