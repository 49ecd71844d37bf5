"""The task of a simulation: a Scene, the forms of its options, and the files that hold one.

Imports `forces`, `integrators` for their names, and what lies below them.
"""
