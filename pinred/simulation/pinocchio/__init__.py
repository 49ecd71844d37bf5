"""The readable engine: the reduced equations by Pinocchio, under SciPy's DOP853."""
