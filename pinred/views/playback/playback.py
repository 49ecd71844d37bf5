"""Numbers for drawing a motion, at the frames of a film.

All are computed by Pinocchio from (q, v): forward kinematics, centre of mass, centroidal momentum
and composite inertia.
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
    """The full simulation, drawn next to the reduced one; arrays are read-only.

    Attributes:
        placements: Placements of joints as in Playback, (F, joints, 7).
        apart: Largest distance of a joint frame between both motions, including its rotation
            times the radius of gyration, (F,) [m].
    """

    placements: Array
    apart: Array

    def __post_init__(self) -> None:
        freeze(self)


@dataclass(frozen=True)
class Playback:
    """A motion at F frames; arrays are read-only, in the world frame.

    Attributes:
        system: The robot.
        t: Times, (F,) [s].
        x: Shapes, (F, m) [rad | m].
        xdot: Shape rates, (F, m) [rad/s | m/s].
        placements: Position [m] and quaternion (real part last) of Pinocchio's joints, of which
            the first is the world, (F, joints, 7).
        com: Centre of mass, (F, 3) [m].
        ellipsoid: Symmetric matrices that map the unit ball to the homogeneous ellipsoid with the
            mass and the locked inertia of the system, (F, 3, 3) [m].
        momentum: The momentum arrow.
        ghost: The full simulation, if requested.
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
    """Compute the numbers for drawing a motion.

    Args:
        source: A trajectory or a recording.
        view: Options of the drawing.
    Returns:
        The numbers at all frames.
    Raises:
        InputError: The base was left out, there are too many frames or fewer than two, or a ghost
            is requested for a recording, which contains no forces.
        LoadError: The robot of a recording cannot be loaded.
    """
    states = _frames(source, view)
    ghost = None
    placements = _placements(source.system, source.system.sorted_q(states.q))
    if view.ghost:
        if not isinstance(source, Trajectory):
            raise InputError(
                "a file of a motion holds no forces, so the full simulation cannot be run; play "
                "the trajectory or its scene file with ghost=True"
            )
        ghost = _ghost(source, states.t, placements)
    return _playback(source.system, states, placements, ghost)


def _frames(source: MotionSource, view: View) -> State:
    """Return the states at the times of the frames."""
    times = frame_times(source, view, MOST_FRAMES)
    return source.states if isinstance(source, Recording) else source(times)


def frame_times(source: MotionSource, view: View, most: int, *, even: bool = False) -> Array:
    """Return the times of the frames, at least two, (F,) [s].

    Args:
        source: The motion.
        view: Its fps and speed determine evenly spaced times.
        most: Largest number of frames.
        even: Use evenly spaced times also for recordings, instead of their own times.
    Returns:
        The times.
    Raises:
        InputError: Too many frames, or a recording with a single time.
    """
    uses_recorded = isinstance(source, Recording) and not even
    if isinstance(source, Recording):
        start, end = float(source.t[0]), float(source.t[-1])
        if len(source.t) < 2:
            raise InputError(f"{source.path} holds one time only; a film needs two at least")
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
    model, data = system.model, system.model.createData()
    placements = np.empty((len(q), model.njoints, 7))
    for k, configuration in enumerate(q):
        pin.forwardKinematics(model, data, configuration)
        for i, placement in enumerate(data.oMi):
            placements[k, i] = pin.SE3ToXYZQUAT(placement)
    return placements


def _ghost(traj: Trajectory, t: Array, placements: Array) -> Ghost:
    """Run the full simulation of a trajectory's scene at the scene's tolerance."""
    scene = traj.scene
    full, start = FullState(scene, traj.motion.replay), scene.start
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    motion = full.run(y0, t, scene.rtol, scene.atol)
    reference = _placements(scene.system, motion.q)
    distance = np.linalg.norm(reference[..., :3] - placements[..., :3], axis=-1)
    p, q = reference[..., 3:], placements[..., 3:]  # q and −q are the same rotation
    chord = np.minimum(np.linalg.norm(p - q, axis=-1), np.linalg.norm(p + q, axis=-1))
    distance += 4.0 * np.arcsin(0.5 * chord) * full.totals.radius_of_gyration(motion.q[0])
    return Ghost(placements=reference, apart=distance.max(axis=1))


def _playback(system: System, states: State, placements: Array, ghost: Ghost | None) -> Playback:
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

    Its moments are I_i = m (a_j² + a_k²)/5, so a_i² = 5 (I_j + I_k − I_i)/(2m). This symmetric
    matrix is continuous in time, while sorted axes would jump.
    """
    moments, axes = np.linalg.eigh(inertia)
    squares = 2.5 / mass * (moments.sum() - 2.0 * moments)
    return np.asarray((axes * np.sqrt(np.maximum(squares, 0.0))) @ axes.T)
