"""Playback: the numbers that are drawn, over the frames of a film.

All of it is Pinocchio's: forward kinematics, centre of mass, centroidal momentum and
composite inertia of (q, v).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..arrays import Array, freeze
from ..errors import InputError
from ..full_state import FullState
from ..scene import Scene
from ..system import System
from ..trajectory import Trajectory
from .recording import Recording, recorded
from .view import View

MOST_FRAMES = 100_000
STILL = 1e-9  # of what the motion could carry; momentum below it is zero


@dataclass(frozen=True)
class Momentum:
    """The conserved momentum as an arrow in space; arrays are read-only.

    vector: (F, 3) in the world frame, exactly zero where it is zero but for round-off.
    tail: (F, 3) where the arrow begins [m].  words: what it is.  unit: of the vector.
    """

    vector: Array
    tail: Array
    words: str
    unit: str

    def __post_init__(self) -> None:
        freeze(self)


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
    """What is drawn at F times; arrays are read-only, in the world frame.

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


def playback(source: Trajectory | Recording, view: View) -> Playback:
    """Return what is to be drawn of a trajectory or of a recorded one.

    Raises InputError if the base was left out, if there would be more than MOST_FRAMES
    frames, or if a ghost is asked for of a recording, which holds no forces.
    """
    recording = _recording(source, view)
    if len(recording.t) > MOST_FRAMES:
        raise _too_many(len(recording.t))
    ghost = None
    placements = _placements(recording.system, recording.q)
    if view.ghost:
        if not isinstance(source, Trajectory):
            raise InputError(
                "a file of a motion holds no forces, so the full simulation cannot be made from "
                "it; play the trajectory or its scene file with ghost=True"
            )
        ghost = _ghost(source.scene, recording.t, placements)
    return _drawn(recording, placements, ghost)


def _recording(source: Trajectory | Recording, view: View) -> Recording:
    """Return the states at the times of the frames, at least two."""
    if isinstance(source, Recording):
        return source
    end = source.scene.end
    count = round(end / view.speed * view.fps) + 1
    if count > MOST_FRAMES:
        raise _too_many(count)
    return recorded(source, np.linspace(0.0, end, max(count, 2)))


def _too_many(count: int) -> InputError:
    return InputError(
        f"{count} frames are too many (at most {MOST_FRAMES}); "
        "play faster, with speed=, or with a lower fps="
    )


def _placements(system: System, q: Array) -> Array:
    """Return the placements of all joints, (F, joints, 7), at q (F, nq)."""
    model, data = system.model, system.model.createData()
    out = np.empty((len(q), model.njoints, 7))
    for k, row in enumerate(q):
        pin.forwardKinematics(model, data, row)
        for i, placement in enumerate(data.oMi):
            out[k, i] = pin.SE3ToXYZQUAT(placement)
    return out


def _ghost(scene: Scene, t: Array, placements: Array) -> Ghost:
    """Return the full simulation of the scene at its own tolerance."""
    full, start = FullState(scene), scene.start
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    motion = full.run(y0, t, scene.rtol, scene.atol)
    seen = _placements(scene.system, motion.q)
    apart = np.linalg.norm(seen[..., :3] - placements[..., :3], axis=-1)
    p, q = seen[..., 3:], placements[..., 3:]  # q and −q are the same rotation
    turn = np.minimum(np.linalg.norm(p - q, axis=-1), np.linalg.norm(p + q, axis=-1))
    apart += 4.0 * np.arcsin(0.5 * turn) * full.radius(motion.q[0])
    return Ghost(placements=seen, apart=apart.max(axis=1))


def _drawn(recording: Recording, placements: Array, ghost: Ghost | None) -> Playback:
    system = recording.system
    model, data = system.model, system.model.createData()
    frames = len(recording.t)
    com, ellipsoid = np.empty((frames, 3)), np.empty((frames, 3, 3))
    vector, reach, most = np.empty((frames, 3)), np.zeros(frames), 0.0
    translates = system.group.linear > 1
    pivot = model.jointPlacements[1].translation
    for k, (q, v) in enumerate(zip(recording.q, recording.v, strict=True)):
        pin.ccrba(model, data, q, v)
        com[k] = data.com[0]
        ellipsoid[k] = _ellipsoid(data.Ig.inertia, data.Ig.mass)
        linear, angular = np.array(data.hg.linear), np.array(data.hg.angular)
        if not translates:
            angular += np.cross(com[k] - pivot, linear)
            reach[k] = float(np.linalg.norm(com[k] - pivot))
        if system.r == 1:
            # Along the one axis of the root joint, in the world frame.
            axis = pin.computeJointJacobians(model, data, q)[:, 0]
            axis = axis[:3] if system.group.linear else axis[3:]
            along = linear if system.group.linear else angular
            vector[k] = axis * (axis @ along + model.armature[0] * v[0])
        else:
            vector[k] = angular
        size = float(np.sqrt(np.trace(data.Ig.inertia) / data.Ig.mass))
        arm = 0.0 if system.group.linear == 1 else size + reach[k]
        most = max(most, _carried(model, data, q, v, arm))
    vector[np.linalg.norm(vector, axis=1) <= STILL * most] = 0.0
    about_com = translates or bool(system.group.linear)
    tail = com.copy() if about_com else np.broadcast_to(np.array(pivot), com.shape).copy()
    return Playback(
        system=system,
        t=recording.t.copy(),
        x=recording.x.copy(),
        xdot=recording.xdot.copy(),
        placements=placements,
        com=com,
        ellipsoid=ellipsoid,
        momentum=Momentum(vector, tail, *_words(system)),
        ghost=ghost,
    )


def _words(system: System) -> tuple[str, str]:
    """Return what the arrow is, and its unit."""
    if system.group.linear == 1:
        return "momentum along the axis", "kg m/s"
    if system.group.linear:
        return "angular momentum about the centre of mass", "kg m²/s"
    about = "the axis" if system.r == 1 else "the pivot"
    return f"angular momentum about {about}", "kg m²/s"


def _carried(model: pin.Model, data: pin.Data, q: Array, v: Array, arm: float) -> float:
    """Return the momentum that a body of this mass, size and energy could carry.

    arm: length that counts as size, or zero for linear momentum.
    """
    most = float(np.sqrt(2.0 * data.Ig.mass * pin.computeKineticEnergy(model, data, q, v)))
    return most * arm if arm else most


def _ellipsoid(inertia: Array, mass: float) -> Array:
    """Return R diag(a) Rᵀ for the semi-axes a of the equivalent homogeneous ellipsoid.

    Its moments are I_i = m (a_j² + a_k²)/5, so a_i² = 5 (I_j + I_k − I_i)/(2m).  As a
    symmetric matrix it is continuous in time, where sorted axes would jump.
    """
    moments, axes = np.linalg.eigh(inertia)
    squares = 2.5 / mass * (moments.sum() - 2.0 * moments)
    return np.asarray((axes * np.sqrt(np.maximum(squares, 0.0))) @ axes.T)
