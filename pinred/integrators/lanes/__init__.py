"""Batches of runs in SIMD lanes: one member per lane, each with its own step length."""
