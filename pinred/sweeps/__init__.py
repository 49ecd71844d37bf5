"""Sweeps: many points of one scene, stored in blocks that survive interruptions."""
