"""Branches of relative equilibria as the momentum varies, followed through folds and pitchforks."""
