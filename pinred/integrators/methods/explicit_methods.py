"""Explicit methods: the dataclasses DOP853, Tsit5 and RKMK4, which hold a method's options.

DOP853 is Dormand and Prince's method of order 8(5,3) in Hairer's form: E. Hairer, S. P. Nørsett,
G. Wanner, Solving Ordinary Differential Equations I, 2nd ed., Springer 1993, sections II.5 and
II.6, and Hairer's code dop853.f. Tsit5 is from Ch. Tsitouras, Runge–Kutta pairs of order 5(4)
satisfying only the first column simplifying assumption, Comput. Math. Appl. 62 (2011) 770–775,
which contains the pair of methods and an interpolant of order 4 without additional stages. RKMK4 is
implemented by explicit/munthe_kaas.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from ...common.memo import once_for_all
from ..explicit.tableau import Tableau
from .method import EqualSteps, Explicit

if TYPE_CHECKING:
    from ..stepping.step_loop import Stepper


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
        """Return the coefficients, which are taken from SciPy."""
        from scipy.integrate._ivp import dop853_coefficients as scipy

        return Tableau(scipy.A.copy(), np.array([scipy.E5, scipy.E3]), scipy.D.copy())


_A = (
    (),
    (0.161,),
    (-0.008480655492356989, 0.335480655492357),
    (2.8971530571054935, -6.359448489975075, 4.3622954328695815),
    (5.325864828439257, -11.748883564062828, 7.4955393428898365, -0.09249506636175525),
    (
        5.86145544294642, -12.92096931784711, 8.159367898576159, -0.071584973281401,
        -0.028269050394068383,
    ),
    (
        0.09646076681806523, 0.01, 0.4798896504144996, 1.379008574103742, -3.290069515436081,
        2.324710524099774,
    ),
)  # fmt: skip
_ERRORS = (
    -0.00178001105222577714, -0.0008164344596567469, 0.007880878010261995, -0.1447110071732629,
    0.5823571654525552, -0.45808210592918697, 1 / 66,
)  # fmt: skip
# Coefficients of θ⁴ in the interpolant. Values and derivatives at both ends give the lower terms.
_DENSE = (
    -1.0530884977290216, 0.1017, 2.490627285651253, -16.548102889244902, 47.37952196281928,
    -34.87065786149661, 2.5,
)  # fmt: skip


@dataclass(frozen=True)
class Tsit5(Explicit):
    """Tsitouras's Runge–Kutta method of order 5(4).

    Its dense output costs no evaluations. The method is rarely faster than DOP853, and only at
    errors of about 1e-4.

    State:
        y, (n,), in any order. The quaternion's four entries are consecutive.
    Attributes:
        rtol: Relative tolerance of a step.
        atol: Absolute tolerance of a step.
        max_steps: Largest number of trial steps, rejected ones included.
        max_step: Longest step [s].
    """

    rtol: float = 1e-6
    atol: float = 1e-8

    about: ClassVar[str] = "Tsitouras's method of order 5"
    order: ClassVar[int] = 5
    dense_order: ClassVar[int] = 4

    @classmethod
    @once_for_all
    def tableau(cls) -> Tableau:
        """Return the coefficients of Tsitouras's paper."""
        A = np.zeros((7, 7))
        for i, row in enumerate(_A):
            A[i, :i] = row
        return Tableau(A, np.array([_ERRORS]), np.array([_DENSE]))


@dataclass(frozen=True)
class RKMK4(EqualSteps):
    """Munthe-Kaas's form of the classical method RK4, with fixed steps that stay on the Lie group.

    State:
        y, (n,), in any order. The quaternion's four entries are consecutive.
    Attributes:
        step: Longest step [s]. All steps are equal, and the last one ends at the end time.
    """

    about: ClassVar[str] = "Munthe-Kaas's form of RK4, with fixed steps"
    order: ClassVar[int] = 4
    dense_order: ClassVar[int] = 3

    def stepper(self) -> Stepper:
        """Return the compiled stepper."""
        from ..explicit.munthe_kaas import STEPPER

        return STEPPER
