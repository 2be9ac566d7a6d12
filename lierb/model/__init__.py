"""Bodies, joints, forces, users' functions, model files, problems and mechanisms."""
