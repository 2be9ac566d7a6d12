"""Figures, report and replays of a study."""
