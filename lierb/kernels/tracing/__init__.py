"""Trace formulas on lane packs, arrays, integers and calls that emit LLVM instructions."""
