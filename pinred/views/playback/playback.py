"""Playback: the numbers that are drawn, over the frames of a film.

All of it is Pinocchio's: forward kinematics, centre of mass, centroidal momentum and
composite inertia of (q, v).
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
from .momentum_arrow import Momentum, conserved_momentum
from .view import View

MOST_FRAMES = 100_000


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
