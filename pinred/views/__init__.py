"""Views of motions: figures, playback in a browser, films.

Imports `simulation`, `analysis`, `judge`, `planning` and the packages below them.
"""
