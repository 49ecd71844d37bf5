"""Integrators as values: what to run, and what each claims to do."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf
from typing import ClassVar, TypeAlias

from ..arrays import positive
from ..errors import InputError


@dataclass(frozen=True)
class DOP853:
    """Dormand and Prince's Runge–Kutta method of order 8(5,3), in Hairer's form.

    rtol, atol: the estimated error of a step stays below atol + rtol |y| in the mean.
    max_steps: of trial steps, the rejected ones included.  max_step: their longest [s].
    """

    rtol: float = 1e-10
    atol: float = 1e-12
    max_steps: int = 1_000_000
    max_step: float = inf

    name: ClassVar[str] = "DOP853"
    order: ClassVar[int] = 8
    dense_order: ClassVar[int] = 7
    symplectic: ClassVar[bool] = False
    adaptive: ClassVar[bool] = True

    def __post_init__(self) -> None:
        positive(self.rtol, "rtol")
        positive(self.atol, "atol")
        if self.max_step != inf:
            positive(self.max_step, "max_step")
        if isinstance(self.max_steps, bool) or not isinstance(self.max_steps, int):
            raise InputError(f"max_steps must be a whole number, got {self.max_steps!r}")
        if self.max_steps < 1:
            raise InputError(f"max_steps must be at least 1, got {self.max_steps}")


@dataclass(frozen=True)
class RKMK4:
    """Munthe-Kaas's form of the classical RK4: fixed steps that stay on the group.

    step: longest step [s]; the end time is met by making all steps equal.
    """

    step: float

    name: ClassVar[str] = "RKMK4"
    order: ClassVar[int] = 4
    dense_order: ClassVar[int] = 3
    symplectic: ClassVar[bool] = False
    adaptive: ClassVar[bool] = False

    def __post_init__(self) -> None:
        positive(self.step, "step")


Method: TypeAlias = DOP853 | RKMK4
