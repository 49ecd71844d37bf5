"""Stability of relative equilibria and of motions, from the linearised reduced flow."""
