"""simulate(): integrate the reduced equations of a scene and reconstruct the base motion.

`explain_plan` describes the terms that a simulation skips, and the numbers that it integrates.
"""

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
from ..kernels.kernel import Layout
from ..reduction.cyclic_joints import SymmetricBall, axial_among, rotors_among
from ..reduction.potential import falling
from ..scene.initial_state import large_angles
from ..scene.scene import ENGINES, Engine, Scene, scene_of
from ..scene.scene_options import SceneOptions
from ..system.model_parameters import joined
from ..system.system import System, checked_system, nominal
from .compiled.code_ahead import expect_integration
from .plan import Plan, plan_of, refuse_with_stops
from .robot_parameters import without_own
from .trajectory import Trajectory, excess_notice, run_plan

if TYPE_CHECKING:
    from .checkpoint import Checkpoint

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
        print(explain_plan(plan))
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
    if engine == "compiled":
        _expect_code(plan)  # before the kernels are imported
    if plan.scene.bounds:
        refuse_with_stops(plan, checkpoint=checkpoint is not None)
    run = partial(run_plan, engine=engine, progress=progress, again=again, checkpoint=checkpoint)
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


def explain_plan(plan: Plan) -> str:
    """Describe the terms that the compiled engine skips, and the numbers that it integrates."""
    zero = _has_no_momentum(plan)
    lines = [f"skipped: {line}" for line in skipped(plan, zero_momentum=zero)]
    lines.append(f"integrated: {integrated(plan)}")
    lines += seen_and_integrated(plan)
    layout = plan.layout(zero_momentum=zero)
    balls = (ball for ball in plan.symmetric_balls if not _is_parameter(layout, ball))
    lines += [f"constant: {ball}" for ball in balls]
    lines += varying(plan)
    if note := large_angles(plan.scene.given.x[0], plan.system):
        lines.append(f"note: {note}")
    if plan.scene.bounds:
        names = dict.fromkeys(bound.joint for bound in plan.scene.bounds)
        lines.append(f"stops: {', '.join(names)}; each set of joints at rest has a kernel")
    if plan.scene.left_out:
        lines.append(f"left out: {plan.scene.left_out}")
    return "\n".join([*lines, f"method: {plan.method.name} ({plan.choice.why})"])


def explain_modes(traj: Trajectory) -> str:
    """Describe the modes of a motion with joint stops: times and joints at rest."""
    modes = traj.motion.modes
    ends = [*(f"{t:.6g}" for t, _ in modes[1:]), f"{traj.scene.end:g} s"]
    lines = [
        f"mode: {label}, t = {t:.6g} to {end}" for (t, label), end in zip(modes, ends, strict=True)
    ]
    return "\n".join([*lines, f"impacts: {len(traj.impacts.times)}"])


def seen_and_integrated(plan: Plan) -> list[str]:
    """Describe how forces depend on the base, and why momentum is integrated or constant."""
    forces = plan.forces
    if forces is None:
        return []
    lines = []
    observed = [
        *(["attitude"] if forces.sees_attitude else []),
        *(["position or velocity"] if forces.sees_place else []),
    ]
    if observed:
        lines.append(f"observed by forces: {' and '.join(observed)} of the base")
    if forces.acting_on_base:
        labels = ", ".join(dict.fromkeys(forces.acting_on_base))
        lines.append(f"also integrated: momentum, because wrenches change it ({labels})")
    elif observed and not plan.momentum_changes:
        lines.append("constant: momentum, because torques do not change it")
    return lines


def _has_no_momentum(plan: Plan) -> bool:
    from .compiled.compiled_flow import has_no_momentum  # which imports the kernels

    return has_no_momentum(plan)


def _is_parameter(layout: Layout, ball: SymmetricBall) -> bool:
    """Return whether the constant momentum of a symmetric ball is a parameter of the kernel."""
    return not {*rotors_among([ball]), *axial_among([ball])}.isdisjoint(layout.constant_pi)


def varying(plan: Plan, *, generic: bool = False) -> list[str]:
    """Describe the robot parameters that are inputs of the kernel, and their cost.

    Args:
        plan: The plan of a scene.
        generic: Whether placements may take any value, as in flows.
    Returns:
        The lines.
    """
    varied = plan.scene.varied
    if varied is None:
        return []
    variables, names = plan.freed(generic=generic), list(plan.system.sorted_model.names)
    lines = []
    if variables.inertias:
        bodies = ", ".join(names[i + 1] for i in variables.inertias)
        lines.append(f"inputs: inertias of the bodies on {bodies} (up to 1.2 × an evaluation)")
    patterned = [names[i + 1] for i, pattern in variables.steps if "x" * 4 not in pattern]
    general = [names[i + 1] for i, pattern in variables.steps if "x" * 4 in pattern]
    if patterned:
        lines.append(
            f"inputs: placements of {', '.join(patterned)}, within their pattern of zeros and "
            "quarter turns (up to 1.2 × an evaluation)"
        )
    if general:
        lines.append(
            f"inputs: placements of {', '.join(general)}, of any kind (of all joints, two "
            "to five evaluations)"
        )
    if variables.links:
        links = ", ".join(str(plan.system.sorted_model.frames[k].name) for k in variables.links)
        lines.append(f"inputs: placements of {links} on their bodies, because forces act there")
    if varied.gravity:
        lines.append("inputs: gravity")
    return lines


def integrated(plan: Plan) -> str:
    """Describe the number of variables of a full simulation and of the compiled engine."""
    full = plan.system.model.nq + plan.system.model.nv
    layout = plan.layout(zero_momentum=_has_no_momentum(plan))
    return f"{full} → {layout.size} numbers"


def skipped(plan: Plan, *, zero_momentum: bool) -> list[str]:
    """Describe the terms that are not integrated or not computed.

    Args:
        plan: The plan of a scene.
        zero_momentum: Whether the angular momentum of the base is zero at the start.
    Returns:
        A line for each group of terms.
    """
    system, forces = plan.system, plan.forces
    names, group = system.shape_names, system.group
    layout = plan.layout(zero_momentum=zero_momentum)
    lines = []
    if not plan.wanted:
        lines.append("the base: it is not requested")
    if group.linear:
        if plan.wrench and plan.wanted:
            lines.append("translation of the base: it follows the centre of mass")
        else:
            lines.append("translation of the base: the centre of mass moves on a known path")
        if falling(system).any():
            lines.append("gravity along it: it only makes the centre of mass fall")
    if group.turns and not layout.base.momentum:
        if zero_momentum:
            lines.append("all terms with momentum: it is zero, and the base follows the shape")
        else:
            lines.append("angular momentum: it follows from the attitude, or is constant")
    if plan.driven:
        driven = ", ".join(names[k] for k in plan.driven)
        lines.append(f"dynamics of the prescribed joints: {driven}")
    if plan.cyclic:
        cyclic = ", ".join(names[k] for k in plan.cyclic)
        lines.append(f"momenta of the cyclic joints, which are constant: {cyclic}")
    lines += [
        f"{ball}, which is constant" for ball in plan.symmetric_balls if _is_parameter(layout, ball)
    ]
    if not system.m:
        lines.append("shape: there is none")
    elif not plan.gravity.any() and forces is None:
        lines.append("potential: nothing acts on the shape")
    return lines
