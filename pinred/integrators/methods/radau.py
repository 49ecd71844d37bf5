"""Radau, as a value: see radau/radau_iia.py."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from .method import ErrorControl

if TYPE_CHECKING:
    from ..stepping.stepper import Stepper


@dataclass(frozen=True)
class Radau(ErrorControl):
    """Radau IIA of order 5 with step control, in Hairer and Wanner's form: for stiff systems.

    rtol, atol, max_steps, max_step: as for DOP853.  Where hard springs or strong dampers
    would keep DOP853 at tiny steps, this goes on in those of the slow motion, damping what it
    does not resolve; elsewhere it is slower.  Newton's method takes the exact Jacobian.
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
