"""Radau as a value; radau/radau_iia.py implements it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from .method import ErrorControl

if TYPE_CHECKING:
    from ..stepping.stepper import Stepper


@dataclass(frozen=True)
class Radau(ErrorControl):
    """Radau IIA of order 5 with step control, in Hairer and Wanner's form: for stiff systems.

    Hard springs or strong dampers force DOP853 to tiny steps. Radau takes steps that resolve the
    slow motion, and damps faster motions. For other systems it is slower than DOP853. Newton's
    method uses the exact Jacobian.

    State:
        y, (n,), in any order. The quaternion's four entries are consecutive.
    Attributes:
        rtol: Relative tolerance of a step.
        atol: Absolute tolerance of a step.
        max_steps: Largest number of trial steps, rejected ones included.
        max_step: Longest step [s].
    """

    rtol: float = 1e-8
    atol: float = 1e-10

    about: ClassVar[str] = "Radau IIA of order 5, for hard springs and dampers"
    order: ClassVar[int] = 5
    dense_order: ClassVar[int] = 5

    def stepper(self) -> Stepper:
        """Return the compiled stepper."""
        from ..radau.radau_iia import STEPPER

        return STEPPER
