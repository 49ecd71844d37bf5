"""pinocchio."""
