"""Implement exp, log, dexp and dexp⁻¹ of SO(3), SE(3), SO(3)×R³ and unit quaternions."""
