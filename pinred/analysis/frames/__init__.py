"""Frames on the body: minimum-perturbation coordinates, surface integrals, flatness tests."""
