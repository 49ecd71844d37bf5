"""RKMK4, as a value: see explicit/munthe_kaas.py."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from .method import EqualSteps

if TYPE_CHECKING:
    from ..stepping.stepper import Stepper


@dataclass(frozen=True)
class RKMK4(EqualSteps):
    """Munthe-Kaas's form of the classical RK4: fixed steps that stay on the group.

    step: longest step [s]; the end time is met by making all steps equal.
    """

    about: ClassVar[str] = "Munthe-Kaas's form of RK4, with fixed steps"
    order: ClassVar[int] = 4
    dense_order: ClassVar[int] = 3

    def stepper(self) -> Stepper:
        """Return the compiled stepper."""
        from ..explicit.munthe_kaas import STEPPER

        return STEPPER
