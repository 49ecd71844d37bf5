"""Phases: the displacement of the base over a cycle of a gait or of a free rigid-body motion."""
