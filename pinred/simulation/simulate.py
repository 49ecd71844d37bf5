"""simulate(): integrate the reduced equations of a scene and reconstruct the base motion."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Unpack

from ..common.argument_kinds import checks_arguments, shows_fields
from ..common.errors import AccuracyWarning, InputError, SceneWarning
from ..common.memo import is_first, once
from ..common.names import brief, listed
from ..common.waiting import LongRunNotice, Progress, shown
from ..integrators.methods import EqualSteps
from ..scene.scene import ENGINES, Engine, Scene, scene_of
from ..scene.scene_options import SceneOptions
from ..system.model_parameters import joined
from ..system.system import System, checked_system, nominal
from .compiled.code_ahead import expect_integration
from .limit_excess import excess_notice
from .plan import Plan, plan_of
from .robot_columns import without_own

if TYPE_CHECKING:
    from .checkpoint import Checkpoint
    from .trajectory import Trajectory

_OPTIONS = Scene.__dataclass_fields__.keys() - {"system"}


@checks_arguments
@shows_fields(Scene)
def simulate(
    scene: System | Scene,
    *,
    engine: Engine = "compiled",
    progress: Progress | bool | None = None,
    explain: bool = False,
    check: bool = False,
    checkpoint: str | Path | None = None,
    **options: Unpack[SceneOptions],
) -> Trajectory:
    """Integrate the reduced equations of a scene and reconstruct the motion of the base.

    Args:
        scene: A System, or a Scene. Options that are passed replace those of the Scene.
        engine: "compiled": machine code compiled for the robot and the kind of scene, cached on
            disk. "pinocchio": the same equations, evaluated with Pinocchio and
            integrated with SciPy's DOP853.
        progress: True for a progress bar in a terminal or a notebook; None for a line if the
            work takes long; False for silence; or a function that is called with the completed
            fraction of the time, from 0 to 1.
        explain: Whether to print the terms that the simulation skips and the variables that it
            integrates.
        check: Whether to test between the stages of steps that no force is skipped, such as one
            that acts in a narrow range of the shape. It costs some further runs.
        checkpoint: File (.ckpt) to which the state of the run is written every minute, at Ctrl-C
            and at the end. If the file exists, the run continues from it, with the same bits as
            without interruption.
        options: Fields of Scene.
    Returns:
        The trajectory.
    Raises:
        InputError: An option is invalid, or options contradict each other.
        ShapeError: An array has the wrong shape.
        SymmetryError: Gravity breaks the symmetry.
        IntegrationError: The integrator cannot continue, or `check` finds a skipped force.
        KernelMismatch: A compiled kernel disagrees with Pinocchio.
    """
    if not (isinstance(engine, str) and engine in ENGINES):
        raise InputError(f"engine: expected one of {', '.join(ENGINES)}, got {brief(engine)}")
    scene = as_scene(scene, options, "simulate")
    if engine == "pinocchio" and scene.method != "auto":
        raise InputError(
            "method: expected none with engine 'pinocchio', which integrates with SciPy's DOP853"
        )
    plan = plan_of(scene if scene.varied is None else without_own(scene))
    if explain:
        from .explain import explain as explained

        print(explained(plan))
    if checkpoint is not None and engine != "compiled":
        raise InputError(
            "checkpoint: expected none with engine 'pinocchio', whose integrator is SciPy's. Use "
            "the compiled engine"
        )
    what = f"simulates '{scene.system.name}'"
    with _opened(checkpoint) as file, shown(progress, "reduced", what=what) as done:
        if done is None and engine == "compiled" and isinstance(plan.method, EqualSteps):
            done = _notice_of(plan.method, scene.end)
        trajectory = _simulated(plan, engine, done, check=check, checkpoint=file)
    if explain and scene.bounds:
        from .explain import explain_modes

        print(explain_modes(trajectory))
    for notice in trajectory.run.notices:
        warnings.warn(notice, AccuracyWarning, stacklevel=3)
    beyond = excess_notice(trajectory.plan, trajectory.motion, trajectory.outputs)
    for notice in filter(None, (free_joints_notice(scene), beyond)):
        warnings.warn(notice, SceneWarning, stacklevel=3)
    return trajectory


def free_joints_notice(scene: Scene) -> str:
    """Return a sentence that names the joints that move freely beside prescribed ones, or ""."""
    if scene.hold is not None or not (names := scene.free_joints):
        return ""
    if not is_first(nominal(scene.system), (free_joints_notice, names)):
        return ""
    moves = "moves" if len(names) == 1 else "move"
    return (
        f"prescribed: nothing drives {listed(names, 8)} of '{scene.system.name}', which {moves} "
        "freely; hold='others' keeps them at their initial positions, hold='free' omits this line"
    )


_MANY_STEPS = 10**6  # number of steps of which a run may take long


def _notice_of(method: EqualSteps, end: float) -> Progress | None:
    """Return a progress function that warns if many equal steps take long, or None."""
    if end <= _MANY_STEPS * method.step:
        return None
    return LongRunNotice(
        f"{type(method).__name__}: {end / method.step:.2g} steps of {method.step:g} s are a long "
        "run; a longer step needs fewer"
    )


def _opened(path: str | Path | None) -> AbstractContextManager[Checkpoint | None]:
    """Return a context that yields the checkpoint in a file; None without a file name."""
    if path is None:
        return nullcontext(None)
    from .checkpoint import opened

    return opened(path)


def _simulated(
    plan: Plan,
    engine: Engine,
    progress: Progress | None = None,
    *,
    check: bool = False,
    checkpoint: Checkpoint | None = None,
) -> Trajectory:
    """Return the trajectory of a plan; with `check`, one whose steps skip no force."""
    again = partial(simulate, plan.scene, engine=engine, check=check)
    run: Callable[[Plan], Trajectory]
    if plan.scene.bounds:
        from .run_with_stops import run_with_stops
        from .stop_engines import refuse_with_stops

        if engine == "compiled":
            _expect_code(plan)
        refuse_with_stops(plan, checkpoint=checkpoint is not None)
        run = partial(
            run_with_stops, progress=progress, again=again, engine=engine, checkpoint=checkpoint
        )
    elif engine == "compiled":
        _expect_code(plan)  # before the kernels are imported
        from .compiled.integrator import run_compiled

        run = partial(run_compiled, progress=progress, again=again, checkpoint=checkpoint)
    else:
        from .pinocchio_engine import run_pinocchio

        run = partial(run_pinocchio, progress=progress, again=again)
    resolved = partial(_resolved, run=run, engine=engine)
    if not check:
        return resolved(plan)
    from .step_resolution import check_has_step_control, resolve_steps

    if engine == "compiled":
        check_has_step_control(plan)
    return resolve_steps(plan, resolved(plan), resolved)


def _expect_code(plan: Plan) -> None:
    """Let other threads generate the code of the plan's method, once for scenes of a structure."""
    once(plan.scene.shared, expect_integration, partial(expect_integration, plan.method))


def _resolved(plan: Plan, run: Callable[[Plan], Trajectory], engine: Engine) -> Trajectory:
    """Return the trajectory of a plan, with steps that resolve functions of time."""
    if not (plan.has_time_functions and plan.method.adaptive):
        return run(plan)
    from .step_resolution import resolve

    return resolve(plan, run, engine)


def as_scene(scene: System | Scene, options: Mapping[str, Any], what: str) -> Scene:
    """Return the scene described by a System or Scene and options.

    Args:
        scene: A System, or a Scene.
        options: Fields of Scene.
        what: Name of the calling function in messages.
    Returns:
        The scene.
    Raises:
        InputError: An option is unknown or invalid.
    """
    if not options.keys() <= _OPTIONS:
        names = [name for name in Scene.__dataclass_fields__ if name != "system"]
        unknown = next(option for option in options if option not in names)
        raise InputError(f"{what} has no option '{unknown}'; the options are {', '.join(names)}")
    if not isinstance(scene, Scene):
        return scene_of(checked_system(scene, what, loops=True), options)
    parameters = options.get("parameters")
    if isinstance(parameters, Mapping):  # keep the parameters that the options do not replace
        options = {**options, "parameters": joined(scene.parameters, parameters)}
    return replace(scene, **options) if options else scene


def trajectory_of(scene: Scene) -> Trajectory:
    """Return the trajectory of a scene with the compiled engine."""
    return _simulated(plan_of(scene), "compiled")
