"""Gauss's collocation methods of order 2 to 16, with equal or error-controlled steps."""
