"""Integrators as values: what to run, and what each claims to do.

name, order, dense_order (of the states between the ends of steps), symplectic, adaptive.
lanes: how many states the kernel of the method evaluates at once.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from math import inf
from numbers import Integral
from typing import Any, ClassVar, TypeAlias

from ..common.arrays import positive
from ..common.errors import InputError

STAGES = 8  # of Gauss's methods, at most
AUTO, FIXED_POINT, NEWTON = range(3)
SOLVERS = {"auto": AUTO, "fixed point": FIXED_POINT, "Newton": NEWTON}


def lanes_of(stages: int) -> int:
    """Return how many stages the kernels of Gauss's methods evaluate at once, idle ones too."""
    return 4 if stages <= 4 else 8


DOP853_LEAST = 2.3e-14  # relative tolerance, ours and SciPy's: below it round-off decides


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
    lanes: ClassVar[int] = 1
    order: ClassVar[int] = 8
    dense_order: ClassVar[int] = 7
    symplectic: ClassVar[bool] = False
    adaptive: ClassVar[bool] = True

    def __post_init__(self) -> None:
        _check_control(self)


@dataclass(frozen=True)
class RKMK4:
    """Munthe-Kaas's form of the classical RK4: fixed steps that stay on the group.

    step: longest step [s]; the end time is met by making all steps equal.
    """

    step: float

    name: ClassVar[str] = "RKMK4"
    lanes: ClassVar[int] = 1
    order: ClassVar[int] = 4
    dense_order: ClassVar[int] = 3
    symplectic: ClassVar[bool] = False
    adaptive: ClassVar[bool] = False

    def __post_init__(self) -> None:
        positive(self.step, "step")


@dataclass(frozen=True)
class Gauss:
    """Gauss–Legendre collocation with fixed steps: symplectic, symmetric, of even order.

    step: longest step [s]; the end time is met by making all steps equal.  order: 2, 4, …, 16.
    Angular momenta and Casimirs are kept to round-off, the energy stays near its value for
    exponentially long times.  solver: how the stages are found, to round-off: "fixed point",
    "Newton" with the exact Jacobian, or "auto", the first as long as it converges well.
    """

    step: float
    order: int = 6
    solver: str = "auto"

    symplectic: ClassVar[bool] = True
    adaptive: ClassVar[bool] = False

    def __post_init__(self) -> None:
        positive(self.step, "step")
        orders = range(2, 2 * STAGES + 1, 2)
        whole = isinstance(self.order, Integral) and not isinstance(self.order, bool)
        if not whole or self.order not in orders:
            raise InputError(
                f"order must be one of {', '.join(map(str, orders))}, got {self.order!r}"
            )
        if self.solver not in [*SOLVERS]:
            raise InputError(f"solver must be one of {', '.join(SOLVERS)}, got {self.solver!r}")

    @property
    def name(self) -> str:
        """Gauss and the order."""
        return f"Gauss{self.order}"

    @property
    def dense_order(self) -> int:
        """That of the steps: a state between them comes from a shorter one."""
        return self.order

    @property
    def stages(self) -> int:
        """Half of the order."""
        return self.order // 2

    @property
    def lanes(self) -> int:
        """How many states the kernel evaluates at once."""
        return lanes_of(self.stages)


@dataclass(frozen=True)
class AdaptiveGauss:
    """Gauss–Legendre collocation of order 16 with step control, for tight tolerances.

    Only for smooth fields: where a force has a kink or a jump, the error of a step is far above
    what it is estimated to be.  rtol, atol, max_steps, max_step: as for DOP853.
    """

    rtol: float = 1e-12
    atol: float = 1e-14
    max_steps: int = 1_000_000
    max_step: float = inf

    name: ClassVar[str] = "AdaptiveGauss"
    lanes: ClassVar[int] = STAGES
    stages: ClassVar[int] = STAGES
    order: ClassVar[int] = 2 * STAGES
    dense_order: ClassVar[int] = 2 * STAGES
    symplectic: ClassVar[bool] = False
    adaptive: ClassVar[bool] = True

    def __post_init__(self) -> None:
        _check_control(self)


@dataclass(frozen=True)
class Radau:
    """Radau IIA of order 5 with step control, in Hairer and Wanner's form: for stiff systems.

    rtol, atol, max_steps, max_step: as for DOP853.  Where hard springs or strong dampers
    would keep DOP853 at tiny steps, this goes on in those of the slow motion, damping what it
    does not resolve; elsewhere it is slower.  Newton's method takes the exact Jacobian.
    """

    rtol: float = 1e-8
    atol: float = 1e-10
    max_steps: int = 1_000_000
    max_step: float = inf

    name: ClassVar[str] = "Radau"
    lanes: ClassVar[int] = 1
    order: ClassVar[int] = 5
    dense_order: ClassVar[int] = 5
    symplectic: ClassVar[bool] = False
    adaptive: ClassVar[bool] = True

    def __post_init__(self) -> None:
        _check_control(self)


@dataclass(frozen=True)
class Variational:
    """A discrete Lagrange–Poincaré integrator with fixed steps, of order 2: see variational.py.

    step: longest step [s]; the end time is met by making all steps equal.
    Its discrete action is stationary: the trapezoidal rule with Cayley's map on the rotations.
    The angular momentum is kept to round-off, the energy stays near its value.  For the same
    error it takes 0.7 to 1 of the time of Gauss of order 2 on a planar chain and on solo12, and
    two to three times as long on the falling cat and a satellite with arms; Gauss of order 4
    or more is better than both.  It needs an angular momentum that is constant, and steps at
    which fixed-point iteration converges.
    """

    step: float

    name: ClassVar[str] = "Variational"
    lanes: ClassVar[int] = 1
    order: ClassVar[int] = 2
    dense_order: ClassVar[int] = 2
    symplectic: ClassVar[bool] = True
    adaptive: ClassVar[bool] = False

    def __post_init__(self) -> None:
        positive(self.step, "step")


def _check_control(method: DOP853 | AdaptiveGauss | Radau) -> None:
    positive(method.rtol, "rtol")
    positive(method.atol, "atol")
    if method.max_step != inf:
        positive(method.max_step, "max_step")
    if isinstance(method.max_steps, bool) or not isinstance(method.max_steps, int):
        raise InputError(f"max_steps must be a whole number, got {method.max_steps!r}")
    if method.max_steps < 1:
        raise InputError(f"max_steps must be at least 1, got {method.max_steps}")


Method: TypeAlias = DOP853 | RKMK4 | Gauss | AdaptiveGauss | Radau | Variational
METHODS: dict[str, type[Method]] = {
    kind.__name__: kind for kind in (DOP853, RKMK4, Gauss, AdaptiveGauss, Radau, Variational)
}


def method_named(
    name: str, step: float | None, order: int | None, rtol: float, atol: float
) -> Method:
    """Return a method by its name, as on the command line: with its step, or tolerances.

    Raises InputError for a name that is none, and where step or order do not go with it.
    """
    if name not in METHODS:
        raise InputError(f"unknown method '{name}'; the methods are {', '.join(METHODS)}")
    kind = METHODS[name]
    wanted = {entry.name for entry in fields(kind)}
    if ("step" in wanted) != (step is not None):
        with_steps = [key for key, value in METHODS.items() if not value.adaptive]
        raise InputError(f"--step H and --method {' or '.join(with_steps)} go together")
    if order is not None and "order" not in wanted:
        raise InputError("--order P goes with --method Gauss")
    given: dict[str, Any] = {"step": step, "order": order, "rtol": rtol, "atol": atol}
    return kind(**{k: v for k, v in given.items() if k in wanted and v is not None})
