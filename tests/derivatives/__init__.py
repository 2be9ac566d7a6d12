"""Derivatives of runs by starts and parameters."""
