"""The reduced equations of motion and their variational principle."""

from .reduction.textbook_equations import constrained_variation as constrained_variation
from .reduction.textbook_equations import euler_poincare as euler_poincare
from .reduction.textbook_equations import (
    euler_poincare_of_lagrangian as euler_poincare_of_lagrangian,
)
from .reduction.textbook_equations import hamilton_poincare as hamilton_poincare
from .reduction.textbook_equations import infinitesimal_generator as infinitesimal_generator
from .reduction.textbook_equations import lagrange_poincare as lagrange_poincare
