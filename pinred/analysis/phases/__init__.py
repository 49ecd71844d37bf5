"""Phases: what a gait, or a free motion, does to the body."""
