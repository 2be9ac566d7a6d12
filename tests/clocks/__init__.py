"""Adaptive steps, output at given times, events, extra states, sampled control.

The folder is not called after its subject: `time` is a module of Python's own.
"""
