"""What is compiled: a plan, its steps, and the loops over steps and blocks."""
