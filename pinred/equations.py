"""The reduced equations of motion (see reduction/equations.py)."""

from .reduction.equations import euler_poincare as euler_poincare
from .reduction.equations import hamilton_poincare as hamilton_poincare
from .reduction.equations import lagrange_poincare as lagrange_poincare
