"""Machine code made for one robot and one structure: its expressions, its judge, its store.

Knows no Scene: what a scene decides comes as a Structure.  Imports `integrators`, `forces`
and what lies below them.
"""
