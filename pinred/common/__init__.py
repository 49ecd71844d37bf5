"""Shared tools: arrays, errors, atomic files, progress bars, and HTML cards for notebooks.

Imports no other package of pinred.
"""
