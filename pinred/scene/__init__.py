"""Scenes: the Scene, its options and their input formats, and TOML files of scenes.

Imports `forces`, `integrators` (for the names of methods), and the packages below them.
"""
