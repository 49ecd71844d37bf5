"""The reduced equations of motion: public names of reduction/textbook_equations.py."""

from .reduction.textbook_equations import euler_poincare as euler_poincare
from .reduction.textbook_equations import hamilton_poincare as hamilton_poincare
from .reduction.textbook_equations import lagrange_poincare as lagrange_poincare
