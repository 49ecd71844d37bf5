"""What every room uses: arrays, errors, files written whole, progress, cards of notebooks.

Imports nothing of pinred.
"""
