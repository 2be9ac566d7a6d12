"""What is broken on purpose, and what must hold then: `python -m faults` from tests/."""
