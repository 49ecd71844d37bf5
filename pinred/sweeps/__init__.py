"""Sweeps: many points of one scene, stored in blocks that survive interruptions.

It imports common, system, integrators, forces, scene and simulation.
"""
