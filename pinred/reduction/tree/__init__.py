"""Sums over the bodies of a tree: articulated and composite inertias, momenta, body frames.

Written once for numbers and for CasADi's symbols.
"""
