"""Branches of relative equilibria over the momentum, through folds and pitchforks."""
