"""Relative equilibria: search for steady motions with a constant shape, and compare them."""
