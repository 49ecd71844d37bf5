"""simulate(): integrate a scene's reduced equations and put the base motion back."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

from ..common.errors import InputError
from ..common.progress import Progress, shown
from ..scene.scene import ENGINES, Engine, Scene
from ..system.system import System, checked_system
from .pieces import follow
from .trajectory import Run, Trajectory


def simulate(
    scene: System | Scene,
    *,
    engine: Engine = "compiled",
    progress: Progress | bool | None = None,
    explain: bool = False,
    **options: Any,
) -> Trajectory:
    """Integrate the reduced equations of a scene and reconstruct the motion of the base.

    scene: a Scene, or a System with the options of Scene: x0, xdot0, xi0 or momentum,
        seed, pose0, duration, times, rtol, atol, springs, forces, prescribed, outputs,
        method.
    engine: "compiled", machine code made for the robot and the kind of scene (and kept on
        disk), or "pinocchio", the same equations by Pinocchio's numbers under SciPy's DOP853.
    progress: True for a progress bar, in a terminal or a notebook; or a function that is
        called now and then with the part of the time that is done, 0 to 1.
    explain: print what the scene lets the simulation skip, and how much is integrated.

    Raises InputError or ShapeError for a scene that makes no sense, SymmetryError if
    gravity breaks the symmetry, IntegrationError if the motion cannot be followed,
    KernelMismatch if a compiled kernel disagrees with Pinocchio.
    """
    if engine not in ENGINES:
        raise InputError(f"unknown engine {engine!r}; the engines are {', '.join(ENGINES)}")
    scene = as_scene(scene, options, "simulate")
    if engine == "pinocchio" and scene.method != "auto":
        raise InputError("engine 'pinocchio' has SciPy's DOP853 for integrator; give no method")
    if explain:
        from .explain import explain_scene

        print(explain_scene(scene))
    route = _compiled if engine == "compiled" else _pinocchio
    with shown(progress, "reduced") as done:
        return route(scene, done)


def as_scene(scene: System | Scene, options: dict[str, Any], what: str) -> Scene:
    """Return the scene that a System or Scene and options make.  Raises InputError."""
    names = [name for name in Scene.__dataclass_fields__ if name != "system"]
    for option in options:
        if option not in names:
            raise InputError(f"{what} has no option '{option}'; they are {', '.join(names)}")
    if not isinstance(scene, Scene):
        return Scene(system=checked_system(scene, what), **options)
    return replace(scene, **options) if options else scene


def _pinocchio(scene: Scene, progress: Progress | None) -> Trajectory:
    from .pinocchio.flow import ReducedFlow
    from .pinocchio.solve import solve

    flow = ReducedFlow(scene)
    began = time.perf_counter()
    motion = follow(scene, flow, solve(flow, scene, progress))
    wall = time.perf_counter() - began
    run = Run("pinocchio", "DOP853", motion.steps, motion.evaluations, wall)
    return Trajectory(scene, motion, run)


def _compiled(scene: Scene, progress: Progress | None) -> Trajectory:
    from .compiled.choose_method import method_of
    from .compiled.flow import CompiledFlow
    from .compiled.solve import prepare, solve

    flow = CompiledFlow(scene)
    prepare(flow, scene)
    began = time.perf_counter()
    motion = follow(scene, flow, solve(flow, scene, progress))
    wall = time.perf_counter() - began
    run = Run("compiled", method_of(scene).name, motion.steps, motion.evaluations, wall)
    return Trajectory(scene, motion, run)
