"""The readable route: the same equations by Pinocchio's numbers, under SciPy's DOP853."""
