"""RKMK4 as a value; explicit/munthe_kaas.py implements it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from .method import EqualSteps

if TYPE_CHECKING:
    from ..stepping.stepper import Stepper


@dataclass(frozen=True)
class RKMK4(EqualSteps):
    """Munthe-Kaas's form of the classical RK4: fixed steps that stay on the group.

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
