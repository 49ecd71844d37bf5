"""Phases: the motion of the base over one cycle of a gait, or of a free rigid body."""
