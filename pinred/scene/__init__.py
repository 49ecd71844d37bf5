"""The task of a simulation: a Scene, its initial state, and the files that hold one.

Imports `forces`, `integrators` for their names, and what lies below them.
"""
