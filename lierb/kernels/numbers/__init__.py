"""What formulas compute with: floats, arrays, structural zeros, packs of lanes, dual numbers."""
