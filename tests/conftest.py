"""Hypothesis profile: failures print what reproduces them; no time limit on noisy machines."""

from hypothesis import settings

settings.register_profile("pinred", deadline=None, print_blob=True)
settings.load_profile("pinred")
