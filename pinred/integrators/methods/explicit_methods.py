"""Explicit methods: the dataclasses DOP853, Tsit5 and RKMK4, which hold a method's options.

Their coefficients are in explicit/tableau.py and, for RKMK4, in
explicit/munthe_kaas.py.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from ...common.argument_kinds import checks_arguments
from ..explicit.tableau import dop853_tableau, tsit5_tableau
from .method import EqualSteps, Explicit

if TYPE_CHECKING:
    from ..explicit.tableau import Tableau
    from ..stepping.step_loop import Stepper


@checks_arguments
@dataclass(frozen=True)
class DOP853(Explicit):
    """Dormand and Prince's Runge–Kutta method of order 8(5,3), in Hairer's form.

    State:
        y, (n,), in any order. All entries of its quaternions are consecutive.
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
    def tableau(cls) -> Tableau:
        """Return the coefficients of Hairer's code."""
        return dop853_tableau()


@checks_arguments
@dataclass(frozen=True)
class Tsit5(Explicit):
    """Tsitouras's Runge–Kutta method of order 5(4).

    Its dense output costs no evaluations. The method is rarely faster than DOP853, and only at
    errors of about 1e-4.

    State:
        y, (n,), in any order. All entries of its quaternions are consecutive.
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
    def tableau(cls) -> Tableau:
        """Return the coefficients of Tsitouras's paper."""
        return tsit5_tableau()


@checks_arguments
@dataclass(frozen=True)
class RKMK4(EqualSteps):
    """Munthe-Kaas's form of the classical method RK4, with fixed steps that stay on the Lie group.

    State:
        y, (n,), in any order. All entries of its quaternions are consecutive.
    Attributes:
        step: Longest step [s]. All steps are equal, and the last one ends at the end time.
    """

    about: ClassVar[str] = "Munthe-Kaas's form of RK4, with fixed steps"
    order: ClassVar[int] = 4
    dense_order: ClassVar[int] = 3

    def _stepper(self) -> Stepper:
        """Return the compiled stepper."""
        from ..explicit.munthe_kaas import STEPPER

        return STEPPER
