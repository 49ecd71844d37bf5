"""inspect(): report a robot's structure at one shape, and the quantities that pinred skips."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array
from ..common.errors import SymmetryError
from ..common.waiting import Wait
from ..reduction.cyclic_joints import SymmetricBall, cyclic_of, symmetric_balls
from ..reduction.pointwise_reduction import PointwiseReduction, ReducedShape, bracket_term
from ..reduction.poisson_brackets import casimirs
from ..reduction.potential import broken_by_gravity
from ..scene.parse_options import actuators_left_out, passive_left_out
from ..scene.scene import Scene
from ..simulation.plan import plan_of
from ..simulation.simulate import skipped
from ..system.hinge_triples import hinge_triples
from ..system.loops.loop_assembly import CLOSED, assemble
from ..system.merge_hinges import actions_of, coupled_joints
from ..system.system import System, checked_system
from .connections.loop_connection import ClosedShape, LoopReduction

_SHAPES = 3  # number of random shapes at which the curvature is tested
_NEARBY = 0.3  # displacement to nearby closed shapes [rad | m]
_ZERO_CURVATURE = 1e-11  # largest curvature of a flat connection, relative to its terms


@checks_arguments
@dataclass(frozen=True)
class Inspection:
    """The structure of a system at one shape.

    Attributes:
        system: The system.
        at: Reduction at the shape; with closed loops, in independent joints.
        curvature_norm: Frobenius norm of the curvature B.
        flat: Whether B vanishes at random shapes. Then closed shape paths do not move the base at
            zero momentum.
        casimirs: Casimirs of the body momentum, as formulas.
        cyclic: Joints on which neither inertia nor potential depends.
        symmetric_balls: Balls whose momentum about an axis of symmetry of their body is constant.
        symmetries: Descriptions of the conserved quantities.
        skipped: Descriptions of the quantities that a simulation does not integrate.
        full_size: Number of variables that a full simulation integrates.
        reduced_size: Number of variables that pinred integrates; None if gravity breaks the
            symmetry.
    """

    system: System
    at: ReducedShape | ClosedShape
    curvature_norm: float
    flat: bool
    casimirs: tuple[str, ...]
    cyclic: tuple[str, ...]
    symmetric_balls: tuple[SymmetricBall, ...]
    symmetries: tuple[str, ...]
    skipped: tuple[str, ...]
    full_size: int
    reduced_size: int | None

    def __str__(self) -> str:
        system, at, left_out = self.system, self.at, _left_out(self.system)
        kinds = [f"{joint.name} ({joint.kind.motion})" for joint in system.space.joints]
        size = "" if self.reduced_size is None else f" → {self.reduced_size} numbers"
        lines = [
            f"{system.name}: {_group(system)}, shape of {system.space.size_in_words}, "
            f"{system.mass:g} kg",
            *_wrapped("joints", kinds),
            *(_wrapped("followers", [*map(str, system.couplings)]) if system.couplings else []),
            *(_wrapped("loops", loops) if (loops := _loops(system)) else []),
            f"gravity     ({', '.join(f'{g:g}' for g in system.gravity)}) m/s²",
            *_wrapped("symmetries", self.symmetries),
            *_wrapped("Casimirs", [", ".join(self.casimirs)] if self.casimirs else []),
            f"connection  {'flat' if self.flat else 'curved'}",
            *_wrapped("skipped", self.skipped),
            *(_wrapped("left out", left_out) if left_out else []),
            *(_wrapped("actuators", actuators) if (actuators := _actuators(system)) else []),
            *(_wrapped("balls", balls) if (balls := _balls(system)) else []),
            *(_wrapped("keyframes", [", ".join(system.keyframes)]) if system.keyframes else []),
            f"integrated  {self.full_size}{size}",
            f"at x =      {_numbers(at.x)}",
            *(_wrapped("independent", [", ".join(_labels(self))]) if system.loops else []),
            _matrix("I", "locked inertia", at.locked_inertia),
            _matrix("A", "local connection", at.local_connection),
            _matrix("M", "reduced metric", at.reduced_metric),
            f"|B|         {self.curvature_norm:.6g} (norm of the curvature)",
        ]
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        from ..common.html import card, line, matrix, number, numbers, table

        system, at = self.system, self.at
        twist, joints = system.group.twist_names, _labels(self)
        size = "" if self.reduced_size is None else f" → {self.reduced_size}"
        facts = [
            *(("symmetry", text) for text in self.symmetries),
            *(("Casimir", text) for text in self.casimirs),
            ("connection", "flat" if self.flat else "curved"),
            *(("skipped", text) for text in self.skipped),
            *(("follower", str(coupling)) for coupling in system.couplings),
            *(("loops", text) for text in _loops(system)),
            *(("left out", text) for text in _left_out(system)),
            *(("actuator", text) for text in _actuators(system)),
            *(("balls", text) for text in _balls(system)),
            *(("keyframe", name) for name in system.keyframes),
            ("integrated", f"{self.full_size}{size} numbers"),
        ]
        return card(
            system.name,
            f"{_group(system)}, shape of {system.space.size_in_words}, {system.mass:g} kg, "
            f"gravity {numbers(system.gravity)} m/s²",
            table("", ["", ""], facts),
            line(f"at x = {numbers(at.x)}:"),
            matrix("locked inertia I", at.locked_inertia, twist, twist),
            matrix("local connection A", at.local_connection, twist, joints),
            matrix("reduced metric M", at.reduced_metric, joints, joints),
            line(f"norm of the curvature B: {number(self.curvature_norm)}"),
        )


@checks_arguments
@Wait("inspects a robot")
def inspect(system: System, x: ArrayLike | None = None) -> Inspection:
    """Describe a system at one shape: its symmetries, reduction and skipped variables.

    Args:
        system: The system.
        x: Shape, (nx,) [rad | m | 1]; None: the shape at rest, or the assembled shape of a robot
            with closed loops.
    Returns:
        The inspection; print it for a summary.
    Raises:
        ShapeError: x has the wrong length or is not finite.
    """
    system = checked_system(system, "inspect", loops=True)
    at, flat = _closed_shape(system, x) if system.loops else _open_shape(system, x)
    names, balls = system.shape_names, symmetric_balls(system)
    cyclic = tuple(names[k] for k in cyclic_of(system, frozenset(), pushed=False))
    size: int | None
    # A generic motion has momentum, so do not use a plan that is simplified for zero momentum.
    generic = Scene(system=system, x0=at.x, xi0=np.ones(system.r))
    try:
        plan = plan_of(generic)
        size = plan.layout(zero_momentum=False).size
        not_needed, symmetry_error = skipped(plan, zero_momentum=False), ""
    except SymmetryError as error:
        size, not_needed, symmetry_error = None, [], str(error)
    return Inspection(
        system=system,
        at=at,
        curvature_norm=float(np.linalg.norm(at.curvature)),
        flat=flat,
        casimirs=tuple(map(str, casimirs(system.open_tree()))),
        cyclic=cyclic,
        symmetric_balls=balls,
        symmetries=tuple(_symmetries(system, cyclic, balls, symmetry_error)),
        skipped=(*not_needed, "meshes: not read"),
        full_size=system.model.nq + system.model.nv,
        reduced_size=size,
    )


def _open_shape(system: System, x: ArrayLike | None) -> tuple[ReducedShape, bool]:
    """Return the reduction at a shape, and whether the curvature vanishes."""
    red = PointwiseReduction(system)
    return red.at(system.space.neutral if x is None else x), _is_flat(red)


def _closed_shape(system: System, x: ArrayLike | None) -> tuple[ClosedShape, bool]:
    """Return the reduction at a closed shape, and whether the curvature vanishes there."""
    assert system.closure is not None
    red = LoopReduction(system)
    shapes = [red.at(system.closure.x if x is None else x)]
    rng, length = np.random.default_rng(0), system.closure.length
    for _ in range(_SHAPES if system.shape_dim > 1 else 0):
        nearby = rng.uniform(-_NEARBY, _NEARBY, system.m)
        closed, gaps = assemble(system, system.space.integrate(shapes[0].x, nearby), length)
        if gaps.max() <= CLOSED:
            shapes.append(red.at(closed))
    return shapes[0], all(_is_flat_at(system, shape) for shape in shapes)


def _is_flat_at(system: System, shape: ReducedShape | ClosedShape) -> bool:
    """Return whether the curvature vanishes at a shape, relative to its terms."""
    A = shape.local_connection
    # For a prismatic joint dA scales with A per metre, so A itself counts as a term.
    terms = (shape.dA, bracket_term(system.group, A), A)
    size = max(float(np.abs(term).max(initial=0.0)) for term in terms)
    return float(np.abs(shape.curvature).max(initial=0.0)) <= _ZERO_CURVATURE * size


def _is_flat(red: PointwiseReduction) -> bool:
    """Return whether the curvature vanishes at random shapes, relative to its terms."""
    rng = np.random.default_rng(0)
    space = red.system.space
    count = _SHAPES if space.m > 1 else 0
    for displacement in rng.uniform(-np.pi, np.pi, (count, space.m)):
        if not _is_flat_at(red.system, red.at(space.integrate(space.neutral, displacement))):
            return False
    return True


def _loops(system: System) -> list[str]:
    """Return one line for each loop, and one for the equations; none without loops."""
    coupled = [
        f"{loop}: linear in independent joints, so its joints are followers"
        for loop in system.contents.coupled_loops
    ]
    if system.closure is None:
        return coupled
    count, rank = system.closure.equations, system.closure.rank
    sizes = f"{count} equations of rank {rank}, closed shapes of dimension {system.shape_dim}"
    return [*coupled, *map(str, system.loops), sizes]


def _labels(inspection: Inspection) -> tuple[str, ...]:
    """Return the labels of the rates in which A and M are stated."""
    at = inspection.at
    return at.independent if isinstance(at, ClosedShape) else inspection.system.shape_names


def _left_out(system: System) -> list[str]:
    """Return one line for each item of the robot file that a run ignores."""
    forces_left_out = passive_left_out(system, who="a run"), actuators_left_out(system, who="a run")
    return [*map(str, system.left_out), *filter(None, forces_left_out)]


def _actuators(system: System) -> list[str]:
    """Return one line for each actuator that controls can drive."""
    return [str(actuator) for actuator in system.actuators]


def _balls(system: System) -> list[str]:
    """Return one line for each three hinges that are, or could be, merged into a ball."""
    merged = [f"{triple} (merged)" for triple in system.contents.merged]
    triples = hinge_triples(
        system.sorted_model, coupled_joints(system.couplings), actions_of(system.passive)
    )
    for triple in triples:
        if not triple.why_not:
            merged.append(
                f"{triple}, which has no gimbal lock, with load(…, balls=['{triple.name}'])"
            )
        elif not triple.obstacle:
            merged.append(f"{triple} is not possible: {triple.difference}")
    return merged


def _group(system: System) -> str:
    """Return the group, its joint, and the body that pinred frees from the world."""
    text = f"group {system.group.name} (r = {system.r}) on joint '{system.root_name}'"
    freed_body = system.contents.freed
    return text + (
        f" (the file fixes '{freed_body}' to the world; here it is free)" if freed_body else ""
    )


def _symmetries(
    system: System,
    cyclic: tuple[str, ...],
    balls: tuple[SymmetricBall, ...],
    symmetry_error: str,
) -> list[str]:
    """Return the conserved quantities as lines of text."""
    if symmetry_error:
        return [symmetry_error]
    conserved = system.group.conserved
    # Gravity reduces SO(3) to rotations about the vertical, unless the robot is balanced.
    if system.group.is_pivot and broken_by_gravity(system):
        conserved = "angular momentum about the direction of gravity through the pivot"
    lines = [f"{system.group.name}: conserves {conserved}"]
    if cyclic:
        lines.append(f"cyclic joints, whose momentum is constant: {', '.join(cyclic)}")
    return [*lines, *(f"{ball} is constant" for ball in balls)]


def _wrapped(title: str, entries: tuple[str, ...] | list[str]) -> list[str]:
    lines = [*entries] or ["none"]
    return [f"{title if k == 0 else '':<11} {line}" for k, line in enumerate(lines)]


def _numbers(values: Array) -> str:
    return "(" + ", ".join(f"{value:g}" for value in values) + ")"


def _matrix(symbol: str, name: str, matrix: Array) -> str:
    if not matrix.size:
        return f"{symbol}           {name}: none, there are no joints"
    with np.printoptions(precision=6, suppress=True, linewidth=110, threshold=400):
        lines = str(matrix).splitlines()
    return f"{symbol}           {name} {matrix.shape}\n" + "\n".join(f"  {row}" for row in lines)
