"""Playback: the numbers that are drawn, over the frames of a film.

All of it is Pinocchio's: forward kinematics, centre of mass, centroidal momentum and
composite inertia of (q, v).  The momentum arrow shows the conserved momentum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...common.arrays import Array, freeze
from ...common.errors import InputError
from ...judge.reference_solution import FullState
from ...simulation.recording import Recording
from ...simulation.trajectory import Trajectory
from ...system.state_fields import State
from ...system.system import System
from ..motion_source import MotionSource
from .view import View

MOST_FRAMES = 100_000

STILL = 1e-9  # of what the motion could carry; momentum below it is zero


@dataclass(frozen=True)
class Ghost:
    """The full simulation, drawn beside the reduced one; arrays are read-only.

    placements: (F, joints, 7) as in Playback.  apart: (F,) how far a joint's frame is at most
    from the same in the other: distance, and angle times the radius of gyration [m].
    """

    placements: Array
    apart: Array

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True)
class Playback:
    """The scene drawn at F times; arrays are read-only, in the world frame.

    t: (F,) [s].  x, xdot: (F, m).  placements: (F, joints, 7) of Pinocchio's joints (the
    first is the world), position [m] and quaternion with the real part last.  com: (F, 3) [m].
    ellipsoid: (F, 3, 3), symmetric: it maps the unit ball to the homogeneous ellipsoid that
    has the mass and the locked inertia of the system about its centre of mass [m].
    momentum: the arrow.  ghost: the full simulation, if asked for.
    """

    system: System
    t: Array
    x: Array
    xdot: Array
    placements: Array
    com: Array
    ellipsoid: Array
    momentum: Momentum
    ghost: Ghost | None

    def __post_init__(self) -> None:
        freeze(self)


def playback(source: MotionSource, view: View) -> Playback:
    """Return what is to be drawn of a trajectory or of a recorded one.

    Raises InputError if the base was left out, if there would be more than MOST_FRAMES
    frames or fewer than two, or if a ghost is asked for of a recording, which holds no forces;
    LoadError if the robot of a recording cannot be loaded.
    """
    states = _frames(source, view)
    ghost = None
    placements = _placements(source.system, source.system.sorted_q(states.q))
    if view.ghost:
        if not isinstance(source, Trajectory):
            raise InputError(
                "a file of a motion holds no forces, so the full simulation cannot be made from "
                "it; play the trajectory or its scene file with ghost=True"
            )
        ghost = _ghost(source, states.t, placements)
    return _drawn(source.system, states, placements, ghost)


def _frames(source: MotionSource, view: View) -> State:
    """Return the states at the times of the frames."""
    times = frame_times(source, view, MOST_FRAMES)
    return source.states if isinstance(source, Recording) else source(times)


def frame_times(source: MotionSource, view: View, most: int, *, even: bool = False) -> Array:
    """Return the times of the frames, (F,) [s], of which there are two at least.

    They are the view's, evenly from first to last; but those that a recording holds, unless
    `even`.  Raises InputError for more than `most`, and for a recording of a single time.
    """
    held = isinstance(source, Recording) and not even
    if isinstance(source, Recording):
        begin, end = float(source.t[0]), float(source.t[-1])
        if len(source.t) < 2:
            raise InputError(f"{source.path} holds one time only; a film needs two at least")
    else:
        begin, end = 0.0, source.scene.end
    wanted = min((end - begin) / view.speed * view.fps, 1e15)
    count = len(source.t) if held else max(2, round(wanted) + 1)
    if count > most:
        raise InputError(
            f"{count} frames are too many (at most {most}); "
            "play faster, with speed=, or with a lower fps="
        )
    return source.t if held else np.linspace(begin, end, count)


def _placements(system: System, q: Array) -> Array:
    """Return the placements of all joints, (F, joints, 7), at q (F, nq)."""
    model, data = system.model, system.model.createData()
    out = np.empty((len(q), model.njoints, 7))
    for k, row in enumerate(q):
        pin.forwardKinematics(model, data, row)
        for i, placement in enumerate(data.oMi):
            out[k, i] = pin.SE3ToXYZQUAT(placement)
    return out


def _ghost(traj: Trajectory, t: Array, placements: Array) -> Ghost:
    """Return the full simulation of a trajectory's scene at its own tolerance."""
    scene = traj.scene
    full, start = FullState(scene, traj.motion.replay), scene.start
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    motion = full.run(y0, t, scene.rtol, scene.atol)
    seen = _placements(scene.system, motion.q)
    apart = np.linalg.norm(seen[..., :3] - placements[..., :3], axis=-1)
    p, q = seen[..., 3:], placements[..., 3:]  # q and −q are the same rotation
    turn = np.minimum(np.linalg.norm(p - q, axis=-1), np.linalg.norm(p + q, axis=-1))
    apart += 4.0 * np.arcsin(0.5 * turn) * full.totals.radius_of_gyration(motion.q[0])
    return Ghost(placements=seen, apart=apart.max(axis=1))


def _drawn(system: System, states: State, placements: Array, ghost: Ghost | None) -> Playback:
    q, v = system.sorted_q(states.q), system.sorted_v(states.v)
    model, data = system.model, system.model.createData()
    com, ellipsoid = np.empty((len(q), 3)), np.empty((len(q), 3, 3))
    for k in range(len(q)):
        pin.ccrba(model, data, q[k], v[k])
        com[k] = data.com[0]
        ellipsoid[k] = _ellipsoid(data.Ig.inertia, data.Ig.mass)
    return Playback(
        system=system,
        t=states.t.copy(),
        x=states.x.copy(),
        xdot=states.xdot.copy(),
        placements=placements,
        com=com,
        ellipsoid=ellipsoid,
        momentum=conserved_momentum(system, q, v),
        ghost=ghost,
    )


def _ellipsoid(inertia: Array, mass: float) -> Array:
    """Return R diag(a) Rᵀ for the semi-axes a of the equivalent homogeneous ellipsoid.

    Its moments are I_i = m (a_j² + a_k²)/5, so a_i² = 5 (I_j + I_k − I_i)/(2m).  As a
    symmetric matrix it is continuous in time, where sorted axes would jump.
    """
    moments, axes = np.linalg.eigh(inertia)
    squares = 2.5 / mass * (moments.sum() - 2.0 * moments)
    return np.asarray((axes * np.sqrt(np.maximum(squares, 0.0))) @ axes.T)


@dataclass(frozen=True)
class Momentum:
    """The momentum that the group conserves, over F frames; arrays are read-only.

    vector: (F, 3) in the world frame, exactly zero where it is zero but for round-off.
    tail: (F, 3) where the arrow begins [m].  words: what it is.  unit: of the vector.
    """

    vector: Array
    tail: Array
    words: str
    unit: str

    def __post_init__(self) -> None:
        freeze(self)


def conserved_momentum(system: System, q: Array, v: Array) -> Momentum:
    """Return the arrow at q (F, nq) and v (F, n), by Pinocchio's centroidal momentum.

    Where the base can turn, angular momentum about the centre of mass, or about the pivot
    if there is one, along the axes about which it can turn; else momentum along its axis.
    """
    model, data = system.model, system.model.createData()
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
        counts = data.hg.linear if slides else spin
        vector[k] = axes @ (axes.T @ counts + rotor[about] * v[k, about])
        mass, size = data.Ig.mass, np.sqrt(np.trace(data.Ig.inertia) / data.Ig.mass)
        carried = np.sqrt(2.0 * mass * pin.computeKineticEnergy(model, data, q[k], v[k]))
        most = max(most, float(carried * (1.0 if slides else size + np.linalg.norm(arm))))
    vector[np.linalg.norm(vector, axis=1) <= STILL * most] = 0.0
    return Momentum(vector, tail, *_words(system))


def _axes(system: System) -> Array:
    """Return the axes of the root joint that count, (3, k), unit vectors in the world frame.

    They are those of the joint's frame; with fewer than three the motion leaves them as they are.
    """
    model, data = system.model, system.model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    motion = np.array(data.joints[1].S).reshape(6, system.r)
    linear = system.group.linear
    own = motion[3:, linear:] if system.group.turns else motion[:3]
    return np.asarray(model.jointPlacements[1].rotation @ own)


def _words(system: System) -> tuple[str, str]:
    """Return what the arrow is, and its unit."""
    group = system.group
    if not group.turns:
        return "momentum along the axis" if group.dim == 1 else "momentum", "kg m/s"
    if group.turns_about_com:
        return "angular momentum about the centre of mass", "kg m²/s"
    about = "the axis" if group.turns == 1 else "the pivot"
    return f"angular momentum about {about}", "kg m²/s"
