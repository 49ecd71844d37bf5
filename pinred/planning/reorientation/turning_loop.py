"""TurnPlan: a joint motion from rest to rest that rotates the base, and the search for its loop.

The initial loop is an ellipse computed from the curvature.  The optimiser then finds the shortest
loop, and Newton steps of least norm reduce the target error to round-off.

A loop is traversed from rest to rest. A base with momentum tumbles during the motion; speeds and
torques have peaks that limit its duration.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ...analysis.connections.connection import Connection
from ...analysis.connections.loop_connection import LoopConnectionCode
from ...analysis.connections.rotation_chart import RotationChart
from ...analysis.phases.gait import Gait
from ...analysis.phases.lift import (
    STAGES,
    Drift,
    PathSegments,
    cycloid,
    fourier_rows,
    in_space_by_momenta,
    lift,
    path_lift,
)
from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays
from ...common.errors import InputError
from ...forces.signals import Attitude
from ...judge.compare import compare
from ...judge.verdict import Report
from ...lie.group import Group
from ...simulation.simulate import simulate
from ...simulation.trajectory import Trajectory
from ...system.system import System
from ..optimisation.gait_search import (
    Passage,
    Path,
    Search,
    StartFailed,
    Task,
    finish,
    fourier_path,
    fourier_path_of,
)
from ..optimisation.limits import NOT_CONSIDERED, Limits, find_extremes, margins
from ..optimisation.objective import TargetAim, rotation_between, torques

TOLERANCES = (1e-12, 1e-14)  # relative and absolute tolerance of a plan's simulation


class SimulatedPlan(FrozenArrays):
    """A joint motion that rotates the base to a target, and its simulation."""

    system: System
    aim: TargetAim

    @property
    @abstractmethod
    def trajectory(self) -> Trajectory:
        """The motion, simulated with a free base."""

    @cached_property
    def report(self) -> Report:
        """Comparison of the trajectory with full ABA under the driving torques."""
        return compare(self.trajectory)

    @property
    def missed(self) -> float:
        """Remaining rotation to the target [rad] in the simulation."""
        group = self.system.group
        pose = self.trajectory.pose
        motion = group.compose(group.inverse(pose[0]), pose[-1])
        return float(np.linalg.norm(self.aim.error(motion)[0]))


@checks_arguments
@dataclass(frozen=True, eq=False, repr=False)
class TurnPlan(SimulatedPlan):
    """A reorientation: a loop of the joints, repeated from rest to rest.

    Attributes:
        system: The system.
        aim: The target.
        gait: The loop; balls move by rotation vectors about their initial attitudes.
        cycles: Number of cycles.
        duration: Total duration [s].
        pose: Final pose of the base, (size,).
        remaining: Remaining rotation from the final attitude to the target [rad].
        momentum: Initial body momentum, (r,).
        left: Final body twist of the base, (r,); zero at zero momentum.
        margins: Smallest distance to the limits of joints, speeds and torques.
        connection: The mechanical connection, over rotation vectors of balls, or over independent
            joints of a robot with closed loops.
    """

    system: System
    aim: TargetAim = field(repr=False)
    gait: Gait
    cycles: int
    duration: float
    pose: Array
    remaining: float
    momentum: Array
    left: Array
    margins: Mapping[str, float]
    connection: Connection = field(repr=False)

    @property
    def chart(self) -> RotationChart | None:
        """Rotation vectors of balls; None without balls."""
        return self.connection.chart

    @cached_property
    def trajectory(self) -> Trajectory:
        """The motion, simulated with a free base.

        The trajectory's `driving_torques` are the joint torques that the plan requires.
        """
        rtol, atol = TOLERANCES
        start, xdot = self.gait.at(0.0)
        formulas = rest_to_rest(self.gait, self.connection.joints, self.cycles, self.duration)
        if isinstance(self.connection.code, LoopConnectionCode):
            start, _ = self.connection.code.state(start, xdot)
        prescribed: dict[str, str | Attitude] = dict(formulas)
        if self.chart is not None:
            start = self.chart.shapes(start)
            for ball in self.chart.space.balls:
                vector = [prescribed.pop(ball.name + axis) for axis in ball.kind.rates]
                prescribed[ball.name] = Attitude(vector, self.chart.centre[ball.x])
        return simulate(
            self.system, x0=start, momentum=self.momentum, duration=self.duration,
            prescribed=prescribed, rtol=rtol, atol=atol,
        )  # fmt: skip

    @property
    def turned(self) -> Array:
        """Total rotation of the base by all cycles: rotation vector (3,) or angle (1,) [rad]."""
        group = self.system.group
        return np.asarray(group.log(self.pose)[group.linear :])

    @property
    def tumble(self) -> float:
        """Angular speed of the base after the motion [rad/s], determined by the momentum."""
        return float(np.linalg.norm(self.left[self.system.group.linear :]))

    def __repr__(self) -> str:
        return (
            f"<TurnPlan of {self.system.name}: {self.cycles} cycles in {self.duration:g} s, "
            f"{self.remaining:.1e} rad remain>"
        )

    def __str__(self) -> str:
        degrees = ", ".join(f"{angle:.6f}" for angle in np.degrees(self.turned))
        lines = [
            f"{self.system.name} turns by its joints: {self.cycles} cycles, {self.duration:g} s",
            f"  turned [°]              {degrees}",
            f"  remaining [rad]         {self.remaining:.1e}",
        ]
        if self.momentum.any():
            lines.append(f"  tumble left [rad/s]     {self.tumble:.6g}, determined by the momentum")
        lines += [f"  margin to {name:<13} {value:.3g}" for name, value in self.margins.items()]
        return "\n".join([*lines, f"  not considered          {NOT_CONSIDERED}"])


def rest_to_rest(gait: Gait, joints: Sequence[str], cycles: int, duration: float) -> dict[str, str]:
    """Return the motion of each joint through several cycles of a gait, from rest to rest.

    The phase angle is the cycloid φ = cycles (a − sin a), a = 2πt/duration. Rates and accelerations
    are zero at both ends.

    Args:
        gait: Gait that is one Fourier series.
        joints: Names of the joints, in order.
        cycles: Number of cycles.
        duration: Duration of all cycles [s].
    Returns:
        A formula in t per joint, for `prescribed` of a Scene.
    """
    c = gait.series.coefficients()
    h = (len(c) - 1) // 2
    a = f"(2*pi*t/{float(duration)!r})"
    angle = f"({cycles}*({a} - sin({a})))"
    formulas = {}
    for j, name in enumerate(joints):
        terms = [repr(float(c[0, j]))]
        for k in range(1, h + 1):
            terms.append(f"({float(c[k, j])!r})*cos({k}*{angle})")
            terms.append(f"({float(c[h + k, j])!r})*sin({k}*{angle})")
        formulas[name] = " + ".join(terms)
    return formulas


_ROOM_USED = 0.7  # largest fraction of the joint range used by the initial ellipse
_OFFSET = 0.3  # fraction of the joint range between trial shapes of the curvature
_FIT = 1e-6  # largest relative error of the rotation that the bivector produces
_POLISH_STEPS = 4  # largest number of full Newton steps
_ROUND_OFF = 1e-14  # rotation error at which the full Newton steps stop [rad]
_DAMPED_STEPS = 40  # largest number of damped Newton steps
_CONVERGENCE = 1e-3  # rotation error below which full Newton steps converge [rad]
_LONGEST = 0.5  # largest rotation of a damped step [rad]
_HARMONICS = 3  # number of harmonics of the loops
_ITERATIONS = 70  # number of iterations of the optimiser; more iterations hardly shorten loops
_EDGE = 1e-3  # fraction of the joint ranges reserved for the final Newton steps
_REACHED = 1e-5  # largest rotation error of the optimiser's loop [rad]
_FINE = 64  # number of quadrature segments of order 16 for the final Newton steps
_FINE_PASSAGE = 24  # number of quadrature segments of order 16 for each cycle from rest to rest


def first_loop(connection: Connection, start: Array, turn: Array, limits: Array) -> Gait:
    """Return the initial ellipse, whose area bivector is the smallest that yields the rotation.

    To leading order, a small loop x₀ − c + c cos φ + s sin φ moves the base by
    exp(−Σ_{a<b} B_ab S_ab), with the bivector S = π (c sᵀ − s cᵀ) of its area and the curvature B
    at x₀.

    Args:
        connection: The connection.
        start: Initial shape, (m,).
        turn: Rotation vector or angle, (turns,) [rad].
        limits: Joint limits, (m, 2); the ellipse is shrunk to fit.
    Returns:
        The ellipse.
    Raises:
        InputError: The curvature near this shape cannot produce the rotation.
    """
    m = connection.m
    room = np.maximum(np.minimum(limits[:, 1] - start, start - limits[:, 0]), 1e-3)
    S = np.zeros((m, m))
    a, b = np.triu_indices(m, 1)
    # At singular shapes, such as rods in a line, use the curvature at neighbouring shapes.
    alternating = _OFFSET * room * np.where(np.arange(m) % 2, -1.0, 1.0)
    for near in (start, start + _OFFSET * room, start + alternating):
        B = connection.curvature(near)[connection.group.linear :, a, b]  # (turns, pairs)
        least = np.linalg.lstsq(-B, turn, rcond=1e-9)[0]
        if np.linalg.norm(B @ least + turn) <= _FIT * np.linalg.norm(turn):
            break
    else:
        raise InputError(
            "small loops from this shape cannot rotate the base as requested; give another x0"
        )
    S[a, b], S[b, a] = least, -least
    # S = Σ σ (u vᵀ − v uᵀ); its leading plane has the singular vectors u and Sᵀu / σ.
    u, sizes, _ = np.linalg.svd(S)
    c = u[:, 0]
    s = S.T @ c
    s = s / max(float(np.linalg.norm(s)), 1e-300)
    radius = np.sqrt(float(sizes[0]) / np.pi)
    reach = np.max(2.0 * np.abs(c) / room + np.abs(s) / room)
    radius = min(radius, _ROOM_USED / float(reach))
    return Gait.fourier(start - radius * c, [radius * c], [radius * s])


def polish_loop(task: Task, aim: TargetAim, path: Path, y: Array) -> Array:
    """Refine unknowns with Newton steps of least norm, Δy = −J⁺ r, for the rotation error r.

    Args:
        task: The task.
        aim: The target.
        path: The family of paths.
        y: Unknowns near a solution.
    Returns:
        The refined unknowns.
    """
    for _ in range(_POLISH_STEPS):
        error, step = _newton_step(task, aim, path, y)
        if error <= _ROUND_OFF:
            break
        y = y + step
    return y


def approach_target(task: Task, aim: TargetAim, path: Path, y: Array) -> Array:
    """Move unknowns towards the target with damped Newton steps of least norm.

    Args:
        task: The task.
        aim: The target.
        path: The family of paths.
        y: Initial unknowns.
    Returns:
        Unknowns from which `polish_loop` converges, or at which the steps stagnate.
    """
    error, step = _newton_step(task, aim, path, y)
    damping = min(1.0, _LONGEST / max(error, 1e-300))
    for _ in range(_DAMPED_STEPS):
        if error <= _CONVERGENCE or damping < 1e-3:
            break
        trial = y + damping * step
        trial_error, trial_step = _newton_step(task, aim, path, trial)
        if trial_error < error:
            y, error, step = trial, trial_error, trial_step
            damping = min(1.0, 2.0 * damping, _LONGEST / max(error, 1e-300))
        else:
            damping *= 0.4
    return y


def _newton_step(task: Task, aim: TargetAim, path: Path, y: Array) -> tuple[float, Array]:
    """Return the rotation error [rad] and the Newton step of least norm."""
    lift = path_lift(task.connection, path.basis, path.coefficients(y), task.drift)
    residual, by_twist = aim.error(lift.pose)
    jacobian = np.tensordot(by_twist, lift.twist, 1).reshape(len(residual), -1) @ path.matrix
    step = -np.linalg.lstsq(jacobian, residual, rcond=1e-12)[0]
    return float(np.linalg.norm(residual)), np.asarray(step, dtype=float)


def turning_loop(task: Task, start: Array, turn: Array, *, quick: bool = False) -> Gait:
    """Find a loop that reaches the target of a task.

    Args:
        task: The task, with a TargetAim.
        start: Initial and final shape, (m,).
        turn: Rotation of the initial loop at zero momentum, (turns,) [rad].
        quick: Whether to use only Newton steps, which ignore limits, instead of the optimiser.
    Returns:
        The loop.
    Raises:
        StartFailed: No loop within the limits was found.
        InputError: The task has no target, or no initial loop exists.
    """
    m, aim = task.connection.m, task.aim
    if not isinstance(aim, TargetAim):
        raise InputError("task: expected a TargetAim")
    gait = first_loop(task.connection, start, turn, task.limits.shape)
    if quick:
        path = fourier_path_of(task, _HARMONICS, start=start)
        y = approach_target(task, aim, path, path.unknowns(gait.series.coefficients(_HARMONICS)))
        gait = Search(task, path).gait(y)
    else:
        gait = _shortest_loop(task, aim, gait, start)
    fine = fine_path(m, start, task.passage)
    y = polish_loop(task, aim, fine, fine.unknowns(gait.series.coefficients()))
    loop = Search(task, fine).gait(y)
    if margins(task.connection, loop, task.limits)["limits"] < 0.0:
        raise StartFailed("the polished loop exceeds the limits")
    return loop


def _shortest_loop(task: Task, aim: TargetAim, gait: Gait, start: Array) -> Gait:
    """Return the shortest loop within limits near a gait.  Raises StartFailed."""
    if task.passage is not None:  # reserve range for the final Newton steps
        edge = _EDGE * task.limits.reach[:, None] * np.array([1.0, -1.0])
        task = replace(task, limits=replace(task.limits, shape=task.limits.shape + edge))
    search = Search(task, fourier_path_of(task, _HARMONICS, start=start, action=True))
    end = finish(search, gait, most=_ITERATIONS, sharp=False)
    search, best = end.search, end.best
    if not _newton_step(task, aim, search.path, best.z)[0] <= _REACHED:
        raise StartFailed(f"the optimiser did not reach the target ({best.status})")
    return search.gait(best.z)


def fine_path(m: int, start: Array, passage: Passage | None, *, finer: int = 1) -> Path:
    """Return a family of Fourier paths whose quadrature is accurate to round-off.

    Args:
        m: Number of joints.
        start: Common initial shape of all paths, (m,).
        passage: Motion from rest to rest, or None.
        finer: Factor on the number of quadrature segments.
    Returns:
        The family of paths.
    """
    pieces = finer * (_FINE if passage is None else _FINE_PASSAGE)
    return fourier_path(_HARMONICS, m, pieces=pieces, power=1, start=start, passage=passage)


_TURN = 2.0 * np.pi
_PER_RADIAN = 4  # number of quadrature segments per radian of tumbling
_MOST = 200.0  # largest tumbling angle of a plan [rad]


def passage_of(
    connection: Connection, momentum: Array, start: Array, cycles: int, time: float
) -> Passage:
    """Create a motion from rest to rest with momentum.

    Args:
        connection: The mechanical connection.
        momentum: Initial body momentum, (r,).
        start: Initial shape, (m,).
        cycles: Number of cycles.
        time: Total duration [s].
    Returns:
        The motion, with enough quadrature segments to resolve the tumbling.
    Raises:
        InputError: The base would tumble too far.
    """
    drift = Drift(connection.code, time * momentum)
    (inverse,) = drift.inverse(start[None])
    angle = float(np.linalg.norm((inverse @ drift.momentum)[connection.group.linear :]))
    if not angle <= _MOST:
        raise InputError(
            f"with joints at rest the base would tumble through {angle:.3g} rad in {time:g} s; "
            "give a shorter duration"
        )
    return Passage(cycles, drift, int(_PER_RADIAN * angle) + 1)


def joint_rotation(
    group: Group, passage: Passage, start: Array, aim: TargetAim
) -> tuple[TargetAim, Array]:
    """Compute the rotation that the joints must contribute to a target.

    Angles that differ by full turns are the same attitude, so the angle nearest to that of the
    drifted base is used.

    Args:
        group: The symmetry group.
        passage: The motion from rest to rest.
        start: Initial shape, (m,).
        aim: The target.
    Returns:
        The target, and the rotation to it from the attitude that the base would drift to with
        joints at rest, (turns,).
    """
    drift = passage.drift
    count = passage.more + STAGES
    inverse = in_space_by_momenta(group, drift.inverse(start[None]))
    still = PathSegments(
        h=np.full(count, 1.0 / count),
        a=np.zeros((count, STAGES, 6)),
        L=np.ascontiguousarray(np.broadcast_to(inverse, (count, STAGES, 6, 6))),
    )
    drifted = lift(group, still, drift.momentum)[-1][group.linear :]
    if group.turns == 1:
        turns = np.round((drifted - aim.attitude) / _TURN)
        aim = TargetAim(group, aim.attitude + _TURN * turns, None)
        return aim, np.asarray(aim.attitude - drifted)
    return TargetAim(group, aim.attitude, None), rotation_between(drifted, aim.attitude)


def final_twist(connection: Connection, momentum: Array, shape: Array, pose: Array) -> Array:
    """Compute the twist I⁻¹Ad_gᵀJ of a base with joints at rest.

    Args:
        connection: The mechanical connection.
        momentum: Spatial momentum J, (r,).
        shape: Shape, (m,).
        pose: Pose, (size,).
    Returns:
        (r,): the body twist.
    """
    (inverse,) = Drift(connection.code, momentum).inverse(shape[None])
    return np.asarray(inverse @ connection.group.Ad(pose).T @ momentum)


_TIMES = 512  # number of samples per cycle
_SAFETY = 1.0 + 1e-6  # factor on the shortest duration, for round-off


@dataclass(frozen=True, eq=False)
class Peaks(FrozenArrays):
    """Largest speed and torque of each joint for a total duration of 1 s.

    Attributes:
        speed: Largest speed of each joint, (m,).
        torque: Largest torque of each joint, (m,).
    """

    speed: Array
    torque: Array

    def needed(self, limits: Limits) -> float:
        """Return the shortest duration within limits [s]; zero if there are no limits."""
        by_speed = np.max(self.speed / limits.speed)
        by_torque = np.sqrt(np.max(self.torque / limits.torque))
        return float(_SAFETY * max(by_speed, by_torque))

    def margins(self, limits: Limits, duration: float) -> dict[str, float]:
        """Compute the smallest distance to the limits of speeds and torques.

        Args:
            limits: The limits.
            duration: Total duration [s].
        Returns:
            Distances by kind; kinds without limits are omitted.
        """
        distances: dict[str, float] = {}
        if np.isfinite(limits.speed).any():
            distances["speeds"] = float((limits.speed - self.speed / duration).min())
        if np.isfinite(limits.torque).any():
            distances["torques"] = float((limits.torque - self.torque / duration**2).min())
        return distances


def peaks_of(connection: Connection, gait: Gait, cycles: int) -> Peaks:
    """Compute the largest speeds and torques of a Fourier gait from rest to rest.

    Args:
        connection: The mechanical connection.
        gait: The gait.
        cycles: Number of cycles.
    Returns:
        The peaks for a total duration of 1 s.
    Raises:
        InputError: The connection has drag.
    """
    if not connection.form.momentum:
        raise InputError("reorient needs a mechanical connection, without drag")
    c, chart = gait.series.coefficients(), connection.chart

    def motion(u: Array) -> tuple[Array, Array, Array]:
        angle, rate, bend = cycloid(u, cycles)
        x, x1, x2 = (rows @ c for rows in fourier_rows((len(c) - 1) // 2, angle, turn=1.0))
        return x, rate[:, None] * x1, rate[:, None] ** 2 * x2 + bend[:, None] * x1

    def speeds(u: Array) -> Array:
        w, rate, _ = motion(u)
        return rate if chart is None else chart.rates(w, rate)

    u = np.linspace(0.0, 1.0, _TIMES * cycles + 1)
    torque = find_extremes(lambda u: torques(connection, *motion(u)), u)[1]
    return Peaks(find_extremes(speeds, u)[1], torque)
