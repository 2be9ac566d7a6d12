"""Tops with velocities of all sizes, each tool brought to the same error by its own tolerance.

The tops of `peers`, the peers of `peers` that choose their own steps, two batches:

    lognormal   each top's initial velocity times a log-normal number, σ = 1: the fastest turns
                some hundred times as fast as the slowest, and so are their steps
    one         one velocity for all

A tool's tolerance is tuned until the largest error of all 512 tops is the wanted one; then it is
timed, on one core. `python -m tolerances` (from bench/, or `make bench-peers`) runs them all, each
in a process of its own.
"""
