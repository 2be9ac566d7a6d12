"""SO(3), SE(3), SO(3)×R³ and unit quaternions: exp, log, dexp and its inverse."""
