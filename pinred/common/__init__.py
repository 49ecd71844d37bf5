"""The ground floor: arrays, errors, files written whole, progress, cards for notebooks.

Imports nothing of pinred.
"""
