"""Sums over the bodies of a tree: articulated and composite inertias, momenta, body frames.

The same code evaluates numbers and builds CasADi expressions.
"""
