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

    rtol, atol: the estimated error of a step stays below atol + rtol |y| in the mean.
    max_steps: of trial steps, the rejected ones included.  max_step: their longest [s].
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
