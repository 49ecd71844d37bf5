"""The readable engine: Pinocchio evaluates the reduced equations, SciPy's DOP853 integrates."""
