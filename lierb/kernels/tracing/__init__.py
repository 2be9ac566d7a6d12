"""Tracing of formulas: lane packs, arrays, integers and calls that emit LLVM instructions."""
