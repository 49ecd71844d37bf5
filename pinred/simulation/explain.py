"""Descriptions of a plan: the terms that the simulation skips and the numbers it integrates."""

from __future__ import annotations

from ..kernels.state_layout import Layout
from ..reduction.cyclic_joints import SymmetricBall, axial_among, rotors_among
from ..reduction.potential import falling
from ..scene.initial_state import large_angles
from .compiled.compiled_flow import has_no_momentum
from .plan import Plan
from .trajectory import Trajectory


def explain(plan: Plan) -> str:
    """Describe the terms that the compiled engine skips, and the numbers that it integrates."""
    lines = [f"skipped: {line}" for line in skipped(plan, zero_momentum=has_no_momentum(plan))]
    lines.append(f"integrated: {integrated(plan)}")
    lines += seen_and_integrated(plan)
    lines += [f"constant: {ball}" for ball in _integrated_constants(plan)]
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
    elif observed and not plan.acting.momentum_changes:
        lines.append("constant: momentum, because torques do not change it")
    return lines


def _integrated_constants(plan: Plan) -> list[SymmetricBall]:
    """Return the symmetric balls whose constant momentum is nevertheless integrated."""
    layout = plan.layout(zero_momentum=has_no_momentum(plan))
    return [ball for ball in plan.acting.symmetric_balls if not _is_parameter(layout, ball)]


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
    freed, names = plan.freed(generic=generic), list(plan.system.sorted_model.names)
    lines = []
    if freed.inertias:
        bodies = ", ".join(names[i + 1] for i in freed.inertias)
        lines.append(f"inputs: inertias of the bodies on {bodies} (up to 1.2 × an evaluation)")
    patterned = [names[i + 1] for i, pattern in freed.steps if "x" * 4 not in pattern]
    general = [names[i + 1] for i, pattern in freed.steps if "x" * 4 in pattern]
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
    if freed.links:
        links = ", ".join(str(plan.system.sorted_model.frames[k].name) for k in freed.links)
        lines.append(f"inputs: placements of {links} on their bodies, because forces act there")
    if varied.gravity:
        lines.append("inputs: gravity")
    return lines


def integrated(plan: Plan) -> str:
    """Describe the number of variables of a full simulation and of the compiled engine."""
    full = plan.system.model.nq + plan.system.model.nv
    layout = plan.layout(zero_momentum=has_no_momentum(plan))
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
        if plan.acting.wrench and plan.wanted:
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
    if plan.acting.driven:
        driven = ", ".join(names[k] for k in plan.acting.driven)
        lines.append(f"dynamics of the prescribed joints: {driven}")
    if plan.acting.cyclic:
        cyclic = ", ".join(names[k] for k in plan.acting.cyclic)
        lines.append(f"momenta of the cyclic joints, which are constant: {cyclic}")
    lines += [
        f"{ball}, which is constant"
        for ball in plan.acting.symmetric_balls
        if _is_parameter(layout, ball)
    ]
    if not system.m:
        lines.append("shape: there is none")
    elif not plan.acting.gravity.any() and forces is None:
        lines.append("potential: nothing acts on the shape")
    return lines
