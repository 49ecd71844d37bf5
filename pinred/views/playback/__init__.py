"""Playback of a motion in a browser, as one HTML file, or as a film."""
