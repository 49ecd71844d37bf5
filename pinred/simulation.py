"""simulate(): integrate a scene's reduced equations and put the base motion back."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from scipy.integrate import DOP853, DenseOutput, OdeSolution

from .arrays import Array
from .errors import InputError, IntegrationError
from .flow import ReducedFlow
from .scene import Scene
from .system import System, checked_system
from .trajectory import Run, Trajectory

Progress = Callable[[float], None]
ENGINES = ("pinocchio",)
MOST_STEPS = 1_000_000


def simulate(
    scene: System | Scene,
    *,
    engine: Literal["pinocchio"] = "pinocchio",
    progress: Progress | None = None,
    **options: Any,
) -> Trajectory:
    """Integrate the reduced equations of a scene and reconstruct the motion of the base.

    scene: a Scene, or a System with the options of Scene: x0, xdot0, xi0 or momentum,
        seed, pose0, duration, times, rtol, atol, springs.
    engine: "pinocchio", the equations by Pinocchio's numbers under SciPy's DOP853.
    progress: called now and then with the part of the time that is done, 0 to 1.

    Raises InputError or ShapeError for a scene that makes no sense, SymmetryError if
    gravity breaks the symmetry, IntegrationError if the motion cannot be followed.
    """
    if engine not in ENGINES:
        raise InputError(f"unknown engine {engine!r}; the engines are {', '.join(ENGINES)}")
    if not isinstance(scene, Scene):
        scene = Scene(system=checked_system(scene, "simulate"), **_known(options))
    elif options:
        scene = replace(scene, **_known(options))
    began = time.perf_counter()
    flow = ReducedFlow(scene)
    solution, steps, evaluations = _integrate(flow, scene, progress)
    run = Run(
        method="DOP853", steps=steps, evaluations=evaluations, wall=time.perf_counter() - began
    )
    return Trajectory(scene, lambda t: flow.states(t, solution(t)), run)


def _known(options: dict[str, Any]) -> dict[str, Any]:
    names = [name for name in Scene.__dataclass_fields__ if name != "system"]
    for option in options:
        if option not in names:
            raise InputError(
                f"simulate has no option '{option}'; the options are {', '.join(names)}"
            )
    return options


def _integrate(
    flow: ReducedFlow, scene: Scene, progress: Progress | None
) -> tuple[Callable[[Array], Array], int, int]:
    """Return the solution, from times (T,) to reduced states (T, k), steps and evaluations."""
    if flow.y0.size == 0:  # one body that only translates: all of its motion is known
        return (lambda t: np.empty((len(t), 0))), 0, 0
    solver = DOP853(flow.rate, 0.0, flow.y0, scene.end, rtol=scene.rtol, atol=scene.atol)
    knots: list[float] = [0.0]
    pieces: list[DenseOutput] = []
    while solver.status == "running":
        if len(pieces) >= MOST_STEPS:
            raise IntegrationError(
                f"'{scene.system.name}' took {MOST_STEPS} steps to t = {solver.t:g} s of "
                f"{scene.end:g} s; shorten the scene or loosen the tolerance"
            )
        with np.errstate(over="ignore", invalid="ignore"):  # what overflows is caught below
            message = solver.step()
            piece = solver.dense_output() if solver.status != "failed" else None
        if not np.isfinite(solver.y).all():
            entry = int(np.argmin(np.isfinite(solver.y)))
            raise IntegrationError(
                f"{flow.entry_name(entry)} of '{scene.system.name}' is not finite after "
                f"t = {knots[-1]:g} s"
            )
        if solver.status == "failed":
            raise IntegrationError(
                f"'{scene.system.name}' cannot be followed beyond t = {solver.t:g} s of "
                f"{scene.end:g} s at rtol = {scene.rtol:g}: {message}"
            )
        knots.append(solver.t)
        pieces.append(piece)
        if progress is not None:
            progress(solver.t / scene.end)
    dense = OdeSolution(knots, pieces)
    return (lambda t: np.asarray(dense(t)).T), len(pieces), solver.nfev
