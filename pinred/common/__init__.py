"""Shared tools: arrays, errors, atomic files, progress bars, and HTML cards for notebooks.

This package imports no other package of pinred.
"""
