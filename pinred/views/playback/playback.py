"""Quantities that are drawn at each frame of a motion.

All quantities are computed with Pinocchio from (q, v): forward kinematics, centre of mass,
centroidal momentum and composite inertia. The momentum arrow shows the conserved momentum. The
shape panel shows the path in shape space over the curvature of the connection.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from ...analysis.full_reduction import Reduction
from ...common.arrays import Array, FrozenArrays
from ...common.errors import InputError
from ...common.names import quoted
from ...judge.compare import full_state_of
from ...judge.stop_reference import StoppedFullState
from ...lie.group import Group
from ...lie.rotations import rotation
from ...simulation.read_recording import Recording
from ...simulation.trajectory import Trajectory
from ...system.joints import axes_of
from ...system.state_fields import State
from ...system.system import System
from ..motion_source import MotionSource
from .colours_and_view_options import View

MOST_FRAMES = 100_000

STILL = 1e-9  # largest momentum that counts as zero, relative to √(2 · mass · kinetic energy)
BASE = "base"  # name of the base where joints name their bodies


@dataclass(frozen=True)
class Ghost(FrozenArrays):
    """The full simulation, drawn next to the reduced one; arrays are read-only.

    Attributes:
        placements: Placements of joints as in Playback, (F, joints, 7).
        apart: Largest distance of a joint frame between both motions, including its rotation
            times the radius of gyration, (F,) [m].
    """

    placements: Array
    apart: Array


@dataclass(frozen=True)
class Playback(FrozenArrays):
    """A motion at F frames; arrays are read-only, in the world frame.

    Attributes:
        system: The robot.
        t: Times, (F,) [s].
        x: Shapes, (F, m) [rad | m].
        xdot: Shape rates, (F, m) [rad/s | m/s].
        placements: Position [m] and quaternion (real part last) of the joints of
            `system.sorted_model`, of which the first is the world, (F, joints, 7).
        com: Centre of mass, (F, 3) [m].
        ellipsoid: Symmetric matrices that map the unit ball to the homogeneous ellipsoid with the
            mass and the locked inertia of the system, (F, 3, 3) [m].
        energy: Energy, (F,) [J].
        momentum: The momentum arrow.
        sphere: The momentum in the axes of a body, if requested.
        ghost: The full simulation, if requested.
        impacts: Times [s] of impacts at joint stops, and the indices of the joints, (K, 2).
    """

    system: System
    t: Array
    x: Array
    xdot: Array
    placements: Array
    com: Array
    ellipsoid: Array
    energy: Array
    momentum: Momentum
    sphere: MomentumSphere | None
    ghost: Ghost | None
    impacts: Array = field(default_factory=lambda: np.empty((0, 2)))


def playback(source: MotionSource, view: View) -> Playback:
    """Compute the quantities for drawing a motion.

    Args:
        source: A trajectory or a recording.
        view: Options of the drawing.
    Returns:
        The quantities at all frames.
    Raises:
        InputError: The base was left out, there are too many frames or fewer than two, a ghost is
            requested for a recording, which contains no forces, or there is no momentum sphere.
        LoadError: The robot of a recording cannot be loaded.
    """
    states = _frames(source, view)
    ghost = None
    placements = _placements(source.system, source.system.sort_q(states.q))
    if view.ghost:
        if not isinstance(source, Trajectory):
            raise InputError(
                "a recording contains no forces, so the full simulation cannot be run; play "
                "the trajectory or its scene file with ghost=True"
            )
        ghost = _ghost(source, states.t, placements)
    return _playback(source, states, placements, view.sphere, ghost)


def _frames(source: MotionSource, view: View) -> State:
    """Return the states of the motion at the times of the frames."""
    times = frame_times(source, view, MOST_FRAMES)
    return source.states if isinstance(source, Recording) else source(times)


def frame_times(source: MotionSource, view: View, most: int, *, even: bool = False) -> Array:
    """Return the times of the frames, at least two, (F,) [s].

    Args:
        source: The motion.
        view: Its fps and speed determine evenly spaced times.
        most: Largest number of frames.
        even: Use evenly spaced times for recordings, too, instead of their report times.
    Returns:
        The times.
    Raises:
        InputError: Too many frames, or a recording with a single time.
    """
    uses_recorded = isinstance(source, Recording) and not even
    if isinstance(source, Recording):
        start, end = float(source.t[0]), float(source.t[-1])
        if len(source.t) < 2:
            raise InputError(f"{source.path} contains only one time; a film needs at least two")
    else:
        start, end = 0.0, source.scene.end
    requested = min((end - start) / view.speed * view.fps, 1e15)
    count = len(source.t) if uses_recorded else max(2, round(requested) + 1)
    if count > most:
        raise InputError(
            f"{count} frames are too many (at most {most}); "
            "play faster, with speed=, or with a lower fps="
        )
    return source.t if uses_recorded else np.linspace(start, end, count)


def _placements(system: System, q: Array) -> Array:
    """Compute the placements of all joints, (F, joints, 7), at q (F, nq)."""
    model, data = system.sorted_model, system.sorted_model.createData()
    placements = np.empty((len(q), model.njoints, 7))
    for k, configuration in enumerate(q):
        pin.forwardKinematics(model, data, configuration)
        for i, placement in enumerate(data.oMi):
            placements[k, i] = pin.SE3ToXYZQUAT(placement)
    return placements


def _ghost(traj: Trajectory, t: Array, placements: Array) -> Ghost:
    """Run the full simulation of a trajectory's scene at the scene's tolerance."""
    scene = traj.scene
    start, full = scene.start, full_state_of(traj)
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    if isinstance(full, StoppedFullState):
        motion = full.solve_with_stops(y0, t, scene.rtol, scene.atol).motion
    else:
        motion = full.run(y0, t, scene.rtol, scene.atol)
    reference = _placements(scene.system, motion.q)
    distance = np.linalg.norm(reference[..., :3] - placements[..., :3], axis=-1)
    p, q = reference[..., 3:], placements[..., 3:]  # q and −q are the same rotation
    chord = np.minimum(np.linalg.norm(p - q, axis=-1), np.linalg.norm(p + q, axis=-1))
    distance += 4.0 * np.arcsin(0.5 * chord) * full.totals.radius_of_gyration(motion.q[0])
    return Ghost(placements=reference, apart=distance.max(axis=1))


def _playback(
    source: MotionSource, states: State, placements: Array, body: str | None, ghost: Ghost | None
) -> Playback:
    system, table = source.system, source.impacts
    q, v = system.sort_q(states.q), system.sort_v(states.v)
    model, data = system.sorted_model, system.sorted_model.createData()
    com, ellipsoid = np.empty((len(q), 3)), np.empty((len(q), 3, 3))
    for k in range(len(q)):
        pin.ccrba(model, data, q[k], v[k])
        com[k] = data.com[0]
        ellipsoid[k] = _ellipsoid(data.Ig.inertia, data.Ig.mass)
    momentum = conserved_momentum(system, q, v)
    sphere = None if body is None else momentum_sphere(system, body, placements, momentum.vector)
    return Playback(
        system=system,
        t=states.t.copy(),
        x=states.x.copy(),
        xdot=states.xdot.copy(),
        placements=placements,
        com=com,
        ellipsoid=ellipsoid,
        energy=states.energy.copy(),
        momentum=momentum,
        sphere=sphere,
        ghost=ghost,
        impacts=np.column_stack([table.t, [model.getJointId(name) for name in table.joint]]),
    )


def _ellipsoid(inertia: Array, mass: float) -> Array:
    """Return R diag(a) Rᵀ for the semi-axes a of the equivalent homogeneous ellipsoid.

    Its moments are I_i = m (a_j² + a_k²)/5, so a_i² = 5 (I_j + I_k − I_i)/(2m). This symmetric
    matrix is continuous in time, while sorted axes would jump.
    """
    moments, axes = np.linalg.eigh(inertia)
    squares = 2.5 / mass * (moments.sum() - 2.0 * moments)
    return np.asarray((axes * np.sqrt(np.maximum(squares, 0.0))) @ axes.T)


@dataclass(frozen=True)
class Momentum(FrozenArrays):
    """The momentum that the group conserves, over F frames; arrays are read-only.

    Attributes:
        vector: Momentum in the world frame, (F, 3); exactly zero if it is round-off.
        tail: Start of the arrow, (F, 3) [m].
        words: Description of the momentum for the legend.
        unit: Unit of the momentum.
    """

    vector: Array
    tail: Array
    words: str
    unit: str


def conserved_momentum(system: System, q: Array, v: Array) -> Momentum:
    """Compute the momentum arrow from Pinocchio's centroidal momentum.

    If the base can rotate, it is the angular momentum about the centre of mass or the pivot, along
    the axes of rotation; otherwise it is the linear momentum along the axes of translation.

    Args:
        system: The robot.
        q: Pinocchio's configurations, (F, nq).
        v: Pinocchio's velocities, (F, n).
    Returns:
        The arrow at all frames.
    """
    model, data = system.sorted_model, system.sorted_model.createData()
    linear, slides = system.group.linear, not system.group.turns
    pivoted = not (slides or system.group.turns_about_com)
    pivot = np.array(model.jointPlacements[1].translation)
    axes, rotor = _axes(system), model.armature
    about = slice(0 if slides else linear, system.r)
    vector, tail, most = np.empty((len(q), 3)), np.empty((len(q), 3)), 0.0
    for k in range(len(q)):
        pin.ccrba(model, data, q[k], v[k])
        tail[k] = pivot if pivoted else data.com[0]
        arm = data.com[0] - tail[k]
        spin = data.hg.angular + np.cross(arm, data.hg.linear)
        momentum = data.hg.linear if slides else spin
        vector[k] = axes @ (axes.T @ momentum + rotor[about] * v[k, about])
        mass, size = data.Ig.mass, np.sqrt(np.trace(data.Ig.inertia) / data.Ig.mass)
        carried = np.sqrt(2.0 * mass * pin.computeKineticEnergy(model, data, q[k], v[k]))
        most = max(most, float(carried * (1.0 if slides else size + np.linalg.norm(arm))))
    vector[np.linalg.norm(vector, axis=1) <= STILL * most] = 0.0
    return Momentum(vector, tail, *_words(system))


def _axes(system: System) -> Array:
    """Return the unit axes (3, k) of the arrow's momentum in the world frame.

    The axes belong to the root joint's frame. If there are fewer than three, the motion does not
    change their directions.
    """
    model, linear = system.sorted_model, system.group.linear
    motion = axes_of(model.joints[1])
    axes = motion[3:, linear:] if system.group.turns else motion[:3]
    return np.asarray(model.jointPlacements[1].rotation @ axes)


def _words(system: System) -> tuple[str, str]:
    """Return the description of the momentum, and its unit."""
    group = system.group
    if not group.turns:
        return "momentum along the axis" if group.dim == 1 else "momentum", "kg m/s"
    if group.turns_about_com:
        return "angular momentum about the centre of mass", "kg m²/s"
    about = "the axis" if group.turns == 1 else "the pivot"
    return f"angular momentum about {about}", "kg m²/s"


@dataclass(frozen=True)
class MomentumSphere(FrozenArrays):
    """The angular momentum in the axes of one body; arrays are read-only.

    A body of a freely turning robot sees a constant momentum move on a sphere. For a rigid robot
    the path is the polhode.

    Attributes:
        joint: Index of the joint that moves the body.
        body: Name of the joint, or "base".
        path: R_jᵀL, relative to the largest |L|, (F, 3).
    """

    joint: int
    body: str
    path: Array


def momentum_sphere(
    system: System, body: str, placements: Array, momentum: Array
) -> MomentumSphere:
    """Compute the path of the angular momentum in the axes of a body.

    Args:
        system: The robot.
        body: Name of the joint that moves the body, or "base".
        placements: Placements of the joints in the world frame, (F, joints, 7).
        momentum: Angular momentum in the world frame, (F, 3).
    Returns:
        The path.
    Raises:
        InputError: There is no such joint, the robot does not turn in space, or its angular
            momentum is zero.
    """
    names = [BASE, *map(str, list(system.sorted_model.names)[2:])]
    if body not in names:
        raise InputError(
            f"sphere: no joint {quoted(body)}; the bodies are named {', '.join(names)}"
        )
    if system.group.turns < 3:
        raise InputError(
            f"sphere: the momentum sphere needs a robot that turns in space, and the group of "
            f"{system.name or 'the robot'} is {system.group.name}; leave the option out"
        )
    largest = float(np.linalg.norm(momentum, axis=1).max())
    if not largest > 0.0:
        raise InputError(
            "sphere: the angular momentum is zero, so it has no path on a sphere; start with a "
            "momentum (momentum=, --momentum), or leave the option out"
        )
    joint = 1 + names.index(body)
    at_base = np.einsum("fji,fj->fi", rotation(placements[:, joint, 3:]), momentum)
    return MomentumSphere(joint=joint, body=body, path=at_base / largest)


_FINE = 61  # number of grid points along each axis of the curvature field
_MARGIN = 0.15  # margin around the path, relative to the range of the path
_TURN = 2.0 * np.pi
_LEAST = 0.2  # smallest range of an axis [rad | m]


@dataclass(frozen=True)
class ShapePanel(FrozenArrays):
    """A path in the plane of two coordinates; arrays are read-only.

    With a single joint, the second axis is the joint rate, and there is no curvature field. The
    field is also missing if a joint makes more rotations than the grid can resolve.

    Attributes:
        labels: Labels of the axes, with units.
        path: The path, (F, 2).
        low: Lower limits of the axes, (2,).
        high: Upper limits of the axes, (2,).
        components: Names of the components of the curvature B_αβ, with units.
        field: Curvature over both joints, (components, N, N), with the other joints at their values
            in the first frame.
    """

    labels: tuple[str, str]
    path: Array
    low: Array
    high: Array
    components: tuple[str, ...]
    field: Array


def shape_panel(
    system: System, x: Array, xdot: Array, pair: Sequence[str] | None = None
) -> ShapePanel | None:
    """Compute the shape panel; None for a rigid body, which has no joints.

    Args:
        system: The robot.
        x: Shapes, (F, nx) [rad | m | 1].  Balls are drawn by their rotation vectors.
        xdot: Shape rates, (F, m) [rad/s | m/s].
        pair: Names of the joints on the axes. If None, the two joints that move most, preferably
            without full rotations.
    Returns:
        The panel.
    Raises:
        InputError: A joint is unknown.
    """
    names, units = system.shape_names, system.units
    for name in pair or ():
        if name not in names:
            raise InputError(f"pair: no joint '{name}'; the joints are {', '.join(names)}")
    if not system.m:
        return None
    x = system.space.chart(x)
    if system.m == 1:
        labels = (f"{names[0]} [{units[0]}]", f"rate of {names[0]} [{units[0]}/s]")
        path = np.column_stack([x[:, 0], xdot[:, 0]])
        return ShapePanel(labels, path, *_range(path), (), np.empty((0, 0, 0)))
    if pair is None:
        ranges = np.ptp(x, axis=0)
        spins = (ranges > _TURN) & np.array([unit == "rad" for unit in units])
        a, b = sorted(map(int, np.lexsort((-ranges, spins))[:2]))
    else:
        a, b = names.index(pair[0]), names.index(pair[1])
    path = x[:, [a, b]]
    low, high = _range(path)
    labels = (f"{names[a]} [{units[a]}]", f"{names[b]} [{units[b]}]")
    # The field is drawn over coordinates, which rotation vectors of balls are not.  Shapes off the
    # closed ones have no meaning for robots with loops.
    if (
        system.space.balls
        or system.loops
        or (high - low)[[units[k] == "rad" for k in (a, b)]].max(initial=0.0) > _FINE / 12 * _TURN
    ):
        return ShapePanel(labels, path, low, high, (), np.empty((0, 0, 0)))
    shapes = np.broadcast_to(x[0], (_FINE, _FINE, system.m)).copy()
    shapes[..., a] = np.linspace(low[0], high[0], _FINE)[:, None]
    shapes[..., b] = np.linspace(low[1], high[1], _FINE)[None, :]
    field = np.moveaxis(Reduction(system).grid(shapes).curvature[..., a, b], -1, 0)
    components = _sort_components(system, field, f"({units[a]}·{units[b]})")
    return ShapePanel(labels, path, low, high, *components)


def _range(path: Array) -> tuple[Array, Array]:
    low, high = path.min(axis=0), path.max(axis=0)
    half = np.maximum((0.5 + _MARGIN) * (high - low), 0.5 * _LEAST)
    return 0.5 * (low + high) - half, 0.5 * (low + high) + half


def _sort_components(system: System, field: Array, per: str) -> tuple[tuple[str, ...], Array]:
    """Sort the components of the field, rotations first, each kind by decreasing magnitude."""
    linear, r = system.group.linear, system.r
    names = [
        f"{words} [{'m' if k < linear else 'rad'}/{per}]"
        for k, words in enumerate(motion_words(system.group))
    ]
    strength = np.abs(field).max(axis=(1, 2))
    order = sorted(range(r), key=lambda k: (k < linear, -strength[k]))
    return tuple(names[k] for k in order), np.ascontiguousarray(field[order])


def motion_words(group: Group) -> list[str]:
    """Return the description of each component of a twist of the group, (r,)."""
    turns = [f"turn about {'xyz'[axis - 3]}" for axis in group.axes[group.linear :]]
    shifts = [f"shift along {'xyz'[axis]}" for axis in group.axes[: group.linear]]
    return [
        *(shifts if len(shifts) > 1 else ["shift"] * len(shifts)),
        *(turns if len(turns) > 1 else ["turn"] * len(turns)),
    ]
