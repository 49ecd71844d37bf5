"""What the engines contribute to a run with joint stops: flows and their integrators."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from typing import Any

from ..common.arrays import Array
from ..common.errors import InputError, IntegrationError
from ..common.waiting import Progress
from ..integrators.methods import ErrorControl
from ..scene.scene import Engine
from ..scene.stop import BallBound, Bound
from .compiled.compiled_flow import CompiledFlow
from .compiled.integrator import integrator
from .plan import Plan
from .reduced_flow import Integrate, ModeFlow

_CHUNK = 8  # Number of steps after which stops are first looked for.


@dataclass(frozen=True)
class StopEngine:
    """What an engine contributes to a run with stops.

    Attributes:
        method: Name of its method.
        degree: Degree of the method's dense output within a step.
        start: Function that returns the flow of a plan.
        integrator: Function from a flow, its plan and `progress` to the flow's integrator.
    """

    method: str
    degree: int
    start: Callable[[Plan], ModeFlow]
    integrator: Callable[[Any, Plan, Progress | None], Integrate]

    @classmethod
    def of(cls, name: Engine, plan: Plan) -> StopEngine:
        """Return the engine for a plan; SciPy is imported for "pinocchio" only."""
        if name == "compiled":
            method, of_flow = plan.method, partial(integrator, chunk=_CHUNK)
            return cls(method.name, method.order, CompiledFlow.of_plan, of_flow)
        from .pinocchio_engine import DEGREE, PinocchioFlow
        from .pinocchio_engine import integrator as scipy_integrator

        return cls("DOP853", DEGREE, PinocchioFlow, scipy_integrator)


def refuse_with_stops(plan: Plan, *, checkpoint: bool) -> None:
    """Reject options of a simulation that do not act together with stops.

    Args:
        plan: The plan of a scene with stops.
        checkpoint: Whether a checkpoint is written.
    Raises:
        InputError: An option does not act together with stops; the message has the remedy.
    """
    method = plan.method
    if not isinstance(method, ErrorControl) or method.symplectic:
        raise InputError(
            f"stops: expected none with method {method.name}, whose steps do not end at impacts. "
            "Use DOP853, Tsit5, Radau or auto, or omit stops"
        )
    if checkpoint and plan.forces is not None and plan.forces.held:
        raise InputError(
            "checkpoint: expected no controllers in a scene with stops, because the impacts are "
            "repeated from the start. Omit checkpoint, or use forces instead of controllers"
        )


def refuse_undefined(bounds: Iterable[Bound], x: Array, t: float) -> None:
    """Reject a ball at its twist stop whose swing reaches π.

    Args:
        bounds: The stops at which joints are.
        x: Shape, (nx,) [rad | m | 1].
        t: Time [s].
    Raises:
        IntegrationError: The twist of a ball is not defined.
    """
    for bound in bounds:
        if isinstance(bound, BallBound) and bound.is_undefined(x):
            raise IntegrationError(
                f"stops: the swing of ball joint '{bound.joint}' reaches π at t = {t:g} s, "
                "where its twist is not defined. Bound its swing as well, such as "
                "BallStop(twist=…, swing=3)"
            )
