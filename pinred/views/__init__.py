"""Motions to look at: figures, playback in a browser, films.

Imports `simulation`, `analysis`, `verification` and what lies below them.
"""
