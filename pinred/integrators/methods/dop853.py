"""Dormand and Prince's method of order 8(5,3), in Hairer's form.

E. Hairer, S. P. Nørsett, G. Wanner, Solving Ordinary Differential Equations I, 2nd ed.,
Springer 1993, sections II.5 and II.6, and Hairer's code dop853.f.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ...common.memo import once_for_all
from ..explicit.tableau import Tableau
from .method import Explicit


@dataclass(frozen=True)
class DOP853(Explicit):
    """Dormand and Prince's Runge–Kutta method of order 8(5,3), in Hairer's form.

    State:
        y, (n,), in any order. The quaternion's four entries are consecutive.
    Attributes:
        rtol: Relative tolerance of a step.
        atol: Absolute tolerance of a step. The root mean square of the estimated errors, each
            divided by atol + rtol |y|, stays below 1.
        max_steps: Largest number of trial steps, rejected ones included.
        max_step: Longest step [s].
    """

    about: ClassVar[str] = "Dormand and Prince's method of order 8"
    order: ClassVar[int] = 8
    dense_order: ClassVar[int] = 7

    @classmethod
    @once_for_all
    def tableau(cls) -> Tableau:
        """Return SciPy's copy of the coefficients."""
        from scipy.integrate._ivp import dop853_coefficients as scipy

        return Tableau(scipy.A.copy(), np.array([scipy.E5, scipy.E3]), scipy.D.copy())
