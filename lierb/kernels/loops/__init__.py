"""Loops over steps and blocks: jobs, workspace, records, and lanes with their own clocks."""
