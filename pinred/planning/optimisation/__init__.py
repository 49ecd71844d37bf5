"""Optimal gaits: objectives, costs, limits, transcription and optimisation."""
