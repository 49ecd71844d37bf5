"""Checks of motions: errors at tolerances, long times, and invariance.

Motions are compared with ABA or with closed forms, or with motions in reversed time, in other
frames and in other units.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
import pinocchio as pin
from scipy.special import ellipj, ellipk, ellipkinc

from ...common.arrays import Array
from ...integrators.methods import DOP853, RKMK4, Gauss, Method
from ...judge.reference_solution import FINEST, FullMotion, FullState, Size
from ...judge.step_defects import largest_defect
from ...scene.scene import Scene
from ...simulation.trajectory import Trajectory
from ...system.find_robot_files import bundled_robots
from ...system.joints import is_prismatic
from ...system.load import load
from ...system.system import System
from .check import EPS, PER_GROWTH, Case, Cases, Trial, check, dop853, tolerance

# Relative tolerances of the checks.
_RETURN_RTOL, _REVERSAL_RTOL = 1e-12, 1e-10
_ENERGY_RTOL, _CASIMIR_RTOL, _UNITS_RTOL = 1e-11, 1e-12, 1e-11
# Bounds in units of the tolerance.
_DENSE = 50.0  # largest defect; dense output has a lower order and no error control
_PER_PERIOD = 10.0  # error per period, because energy may drift by a tolerance per step
_PER_SQUARE = 1.0  # error per squared period: energy drift shifts the phase
# Bounds in units of eps times the square root of the number of steps.
_ENERGY_ROUNDING = 10.0
_WALK = 10.0
_ROUNDING = 50.0  # times the growth


@check("error by ABA over 10 s, relative, per tolerance")
def tolerances(trial: Trial) -> Cases:
    """Compare every bundled robot with ABA, at tolerances from 1e-4 to 1e-13."""
    for name in trial.pick(("planar_chain5", "falling_cat"), tuple(bundled_robots())):
        scene = Scene(system=load(name))
        times = samples(scene)
        reference = aba_reference(scene, times)
        for k in trial.pick((4, 8, 13), tuple(range(4, 14))):
            rtol = 10.0**-k
            for method in trial.methods(rtol):
                traj = trial.simulate(scene.system, method=method, **tolerance(rtol))
                error = reference.error(traj, times) / rtol
                yield Case(f"{name}, {traj.run.method}, {rtol:.0e}", error, PER_GROWTH)


@check("defect of half a step, per tolerance")
def between(trial: Trial) -> Cases:
    """Check that dense output satisfies the equations of motion between step ends."""
    for name in trial.pick(("falling_cat",), tuple(bundled_robots())):
        system = load(name)
        for rtol in trial.pick((1e-10,), (1e-4, 1e-6, 1e-8, 1e-10, 1e-12)):
            for method in trial.methods(rtol):
                traj = trial.simulate(system, method=method, **tolerance(rtol))
                defect = largest_defect(traj, system, subintervals=True) / rtol
                yield Case(f"{name}, {traj.run.method}, {rtol:.0e}", defect, _DENSE)


@check("difference after whole periods, per tolerance")
def periods(trial: Trial) -> Cases:
    """Check that periodic motions return to their initial state after each closed-form period."""
    counts = trial.pick((1, 100), (1, 10, 100, 1000))
    for swing in swings():
        traj = trial.simulate(
            swing.system,
            x0=swing.x0,
            xi0=swing.xi0,
            times=swing.period * np.array(counts, dtype=float),
            **tolerance(_RETURN_RTOL),
        )
        rates = np.hstack([traj.xdot, traj.xi]) - np.append(0.0 * swing.x0, swing.xi0)
        size = max(1.0, float(np.abs(swing.xi0).max()))
        for k, count in enumerate(counts):
            error = np.abs(np.append(traj.x[k] - swing.x0, rates[k])).max() / size
            bound = _PER_PERIOD * count + _PER_SQUARE * count**2
            yield Case(f"{swing.name}, {count} periods", float(error) / _RETURN_RTOL, bound)


@check("error of the return, relative, per tolerance")
def reversal(trial: Trial) -> Cases:
    """Check that a motion with reversed rates returns to its initial state."""
    for name in trial.pick(("falling_cat", "cartpole"), tuple(bundled_robots())):
        system = load(name)
        scene = Scene(system=system)
        start, end = scene.start, np.array([scene.end])
        reference = aba_reference(scene, samples(scene))
        forward = trial.simulate(system, times=end, **tolerance(_REVERSAL_RTOL))
        back = trial.simulate(
            system,
            pose0=forward.pose[-1],
            x0=forward.x[-1],
            xdot0=-forward.xdot[-1],
            xi0=-forward.xi[-1],
            times=end,
            **tolerance(_REVERSAL_RTOL),
        )
        initial = FullMotion(x=start.x[None], q=system.q(start.pose, start.x)[None])
        final = FullMotion(x=back.x, q=back.q)
        pose_error = reference.full.distance(initial, final).worst(reference.size)
        rates = np.concatenate([start.xi, start.xdot])
        rate_error = np.abs(np.concatenate([back.xi[-1], back.xdot[-1]]) + rates).max()
        error = max(pose_error, float(rate_error / np.abs(rates).max()))
        yield Case(name, error / _REVERSAL_RTOL, PER_GROWTH * reference.growth)


_SAMPLES = 500
_SIGMAS = 4.0  # significance of a slope, in standard deviations
_DRIFTING = 10_000  # largest number of periods for methods with an energy drift
_STEPS = 59.3  # steps per period; not an integer, so that steps and motion do not resonate


Make: TypeAlias = Callable[[float], Method]


@dataclass(frozen=True)
class Swing:
    """A periodic motion.

    Attributes:
        name: Name of the motion.
        system: The system.
        x0: Initial shape, (m,).
        xi0: Initial body twist, (r,).
        period: Period in closed form [s].
    """

    name: str
    system: System
    x0: Array
    xi0: Array
    period: float


def swings() -> list[Swing]:
    """Return a pole that swings on a free cart, and a tumbling rigid body."""
    pole = load("cartpole")
    omega, moments = np.array([0.5, 0.7, 1.6]), np.array([1.0, 2.0, 2.5])
    _, period = euler_top(moments, omega, np.zeros(1))
    swing = cartpole_period(mass=3.0, lever=0.5, moment=0.34, gravity=9.81, most=1.0)
    return [
        Swing("cartpole", pole, np.ones(1), np.zeros(1), swing),
        Swing("rigid_body", load("rigid_body"), np.empty(0), omega, period),
    ]


# Pinocchio computes the energies of states at random times, so that no phase is preferred. The
# drift is the slope of the fitted line, with its standard deviation.
@check("change of energy, relative")
def energy(trial: Trial) -> Cases:
    """Fit lines to the energy over up to a million periods: symplectic methods have no slope."""
    periods = trial.pick(1000, 100_000, 1_000_000)
    for swing in swings():
        h = swing.period / _STEPS
        for make in trial.fixed:
            verify = _check_bounded if make(h).symplectic else _check_drifting
            yield from verify(trial, swing, make, periods)
        line = _fit_line(trial, swing, dop853(_ENERGY_RTOL, 1e-2 * _ENERGY_RTOL), periods)
        change = (abs(line.change) + _SIGMAS * line.uncertainty) / periods
        yield Case(f"{swing.name}, DOP853, change in a period", change, 10.0 * _ENERGY_RTOL)


def _check_bounded(trial: Trial, swing: Swing, make: Make, periods: int) -> Cases:
    """Check that the energy of a symplectic method has no measurable slope or growing changes."""
    method = make(swing.period / _STEPS)
    line = _fit_line(trial, swing, method, periods)
    case = f"{swing.name}, {method.name}, {periods:.0e} periods"
    rounding = _ENERGY_ROUNDING * EPS * math.sqrt(periods * _STEPS)
    yield Case(f"{case}, slope", abs(line.change), _SIGMAS * line.uncertainty + rounding)
    yield Case(f"{case}, largest change", line.most, 2.0 * line.early + rounding)


def _check_drifting(trial: Trial, swing: Swing, make: Make, periods: int) -> Cases:
    """Check that the energy loss of a method of order p decreases at least with step^p."""
    count = min(periods // 10, _DRIFTING)  # longer runs lose too much energy for a linear fit
    coarse, fine = (
        _fit_line(trial, swing, make(swing.period / (n * _STEPS)), count) for n in (1, 2)
    )
    method = make(swing.period)
    case = f"{swing.name}, {method.name}"
    yield Case(f"{case}, uncertainty of its slope", fine.uncertainty / abs(fine.change), 0.1)
    ratio = abs(fine.change / coarse.change)
    yield Case(f"{case}, slope at half the step", ratio, 2.0 ** (0.5 - method.order))


@dataclass(frozen=True)
class Line:
    """Changes of energy over time, relative to the largest kinetic energy.

    Attributes:
        change: Change of the fitted line from start to end.
        uncertainty: Standard deviation of `change`.
        most: Largest change.
        early: Largest change in the first hundredth of the time.
    """

    change: float
    uncertainty: float
    most: float
    early: float


def _fit_line(trial: Trial, swing: Swing, method: Method, periods: int) -> Line:
    end = swing.period * periods
    rng = np.random.default_rng(3)
    early, late = rng.uniform(0.0, 0.01 * end, _SAMPLES), rng.uniform(0.0, end, _SAMPLES)
    times = np.union1d(np.concatenate([early, late]), [0.0, end])
    traj = trial.simulate_many(
        swing.system, x0=swing.x0[None], xi0=swing.xi0[None], times=times, method=method
    )[0]
    energy, kinetic = _energies(swing.system, traj.q, traj.v)
    change = (energy - energy[0]) / kinetic.max()
    fraction = times / end
    coefficients, covariance = np.polyfit(fraction, change, 1, cov=True)
    return Line(
        change=float(coefficients[0]),
        uncertainty=math.sqrt(covariance[0, 0]),
        most=float(np.abs(change).max()),
        early=float(np.abs(change[fraction <= 0.01]).max()),
    )


def _energies(system: System, q: Array, v: Array) -> tuple[Array, Array]:
    """Compute total and kinetic energies, (T,) each, with Pinocchio."""
    model, data = system.model, system.model.createData()
    kinetic = np.array([pin.computeKineticEnergy(model, data, *s) for s in zip(q, v, strict=True)])
    height = np.array([pin.computePotentialEnergy(model, data, q_k) for q_k in q])
    return kinetic + height, kinetic


# Initial twist of the base, and the step [s]; joints have their default initial state.
_STARTS = {
    "rigid_body": (np.array([0.5, 0.7, 1.6]), 0.1),
    "falling_cat": (np.array([0.1, 0.0, -0.1, 0.8, 0.4, -0.3]), 0.02),
}


# The momentum is computed with Pinocchio from (q, v), and the quaternion is checked by its norm.
# Without the base, DOP853 integrates the three components of μ. Their norm is a Casimir function, a
# constant of motion that DOP853 conserves up to its tolerance. Gauss methods lift μ to the
# quaternion.
@check("difference from the start, relative")
def casimirs(trial: Trial) -> Cases:
    """Check that quaternions and momenta drift at most like a random walk of round-off."""
    count = trial.pick(10_000, 1_000_000, 10_000_000)
    walk = _WALK * EPS * math.sqrt(count)
    for name, (xi0, h) in _STARTS.items():
        system, times = load(name), np.linspace(0.0, count * h, 201)
        methods: list[Method] = [_fixed_dop853(h), *(make(h) for make in trial.fixed)]
        for method in methods:
            traj = trial.simulate_many(system, xi0=xi0[None], times=times, method=method)[0]
            case = f"{name}, {method.name}, {count:.0e} steps"
            length = np.linalg.norm(traj.pose[:, -4:], axis=1)
            yield Case(f"{case}, quaternion", float(np.abs(length - 1.0).max()), 4 * EPS)
            momentum = _momenta(system, traj.q, traj.v)
            drift = np.abs(momentum - momentum[0]).max() / np.linalg.norm(momentum[0])
            yield Case(f"{case}, momentum", float(drift), walk)
    yield _casimir(trial, count)


def _fixed_dop853(h: float) -> Method:
    """Return DOP853 with a tolerance that accepts all steps, so that all have length h."""
    return DOP853(rtol=1e3, atol=1e3, max_step=h, max_steps=10**12)


def _casimir(trial: Trial, count: int) -> Case:
    """Check the drift of |μ| if DOP853 integrates a body without its attitude."""
    xi0, h = _STARTS["rigid_body"]
    end = count * h
    mu = trial.simulate_many(
        load("rigid_body"),
        xi0=xi0[None],
        times=np.linspace(0.0, end, 201),
        method=dop853(_CASIMIR_RTOL, 1e-2 * _CASIMIR_RTOL),
        outputs="shape",
    ).y[0]
    length = np.linalg.norm(mu, axis=1)
    change = float(np.abs(length / length[0] - 1.0).max())
    angle = end * float(np.linalg.norm(xi0))
    return Case("DOP853, Casimir |μ| without the base, per radian", change / angle, _CASIMIR_RTOL)


def _momenta(system: System, q: Array, v: Array) -> Array:
    """Compute the angular momentum about the centre of mass with Pinocchio.

    The base is moved to the origin, because round-off grows with the distance from it.

    Returns:
        (T, 3) angular momentum [N·m·s].
    """
    model, data = system.model, system.model.createData()
    centred = q.copy()
    centred[:, : system.group.linear] = 0.0
    return np.array(
        [
            pin.computeCentroidalMomentum(model, data, *state).angular.copy()
            for state in zip(centred, v, strict=True)
        ]
    )


_TIMES = np.linspace(0.0, 5.0, 21)


# With fixed steps, motions differ by round-off alone. Step control amplifies round-off, because
# error estimates that are only round-off then determine the step length.
@check("difference of shape and pose, at 21 times")
def frames(trial: Trial) -> Cases:
    """Check that a motion does not depend on the frames of the world and of the base."""
    methods: list[Method | Literal["auto"]] = ["auto", *(make(1e-2) for make in trial.fixed)]
    for name in trial.pick(("falling_cat",), ("falling_cat", "satellite_two_arms")):
        system = load(name)
        scene = Scene(system=system, times=_TIMES)
        growth = aba_reference(scene, _TIMES[1:]).growth
        rng = np.random.default_rng(1)
        frames = [_frame(rng) for _ in range(trial.pick(5, 100))]
        # Every frame of the base needs a separate kernel.
        robots = [_with_base_frame(system, frame) for frame in frames[: trial.pick(2, 12, 100)]]
        for method in methods:
            reference = trial.simulate(system, times=_TIMES, method=method)
            bound = _ROUNDING * EPS * growth * math.sqrt(reference.run.steps)
            if method == "auto":
                bound += scene.rtol
            case = f"{name}, {reference.run.method}"
            still = pin.SE3.Identity()
            world = max(
                _error_in_frames(trial, reference, system, frame, still) for frame in frames
            )
            yield Case(f"{case}, {len(frames)} frames of the world", world, bound)
            base = max(
                _error_in_frames(trial, reference, robot, still, frame)
                for robot, frame in zip(robots, frames, strict=False)
            )
            yield Case(f"{case}, {len(robots)} frames of the base", base, bound)


def _error_in_frames(
    trial: Trial, reference: Trajectory, robot: System, world: pin.SE3, base: pin.SE3
) -> float:
    """Compare a motion with the motion of a robot in other frames of the world and of its base.

    Args:
        trial: Functions under test.
        reference: Motion in the original frames.
        robot: The robot, with its base frame at `base` in the original one.
        world: Pose of the original frame of the world in the new one.
        base: Pose of the new frame of the base in the original one.
    Returns:
        The largest difference of shapes and poses.
    """
    start = reference.scene.start
    other = trial.simulate(
        robot,
        x0=start.x,
        xdot0=start.xdot,
        xi0=base.inverse().toActionMatrix() @ start.xi,
        pose0=pin.SE3ToXYZQUAT(world * base),
        times=_TIMES,
        method=reference.scene.method,
    )
    gaps = [
        pin.log6((world * pin.XYZQUATToSE3(a) * base).actInv(pin.XYZQUATToSE3(b))).vector
        for a, b in zip(reference.pose, other.pose, strict=True)
    ]
    return float(max(np.abs(reference.x - other.x).max(), np.abs(gaps).max()))


def _frame(rng: np.random.Generator) -> pin.SE3:
    """Return a random frame, translated by less than the robot's size."""
    return pin.SE3(pin.exp3(rng.uniform(-2.0, 2.0, 3)), rng.uniform(-0.5, 0.5, 3))


def _with_base_frame(system: System, frame: pin.SE3) -> System:
    """Return the robot with its base frame moved to the pose `frame` in the old base frame."""
    model = system.model.copy()
    inverse = frame.inverse()
    model.inertias[1] = inverse.act(model.inertias[1])
    for i in range(2, model.njoints):
        if model.parents[i] == 1:
            model.jointPlacements[i] = inverse * model.jointPlacements[i]
    return load(model)


_NO_ATOL = 1e-30  # an absolute tolerance would depend on the units
# Without any absolute tolerance, an angle that starts at zero would require a first step of zero.
_POSES = {"falling_cat": None, "cartpole": None, "planar_chain5": [0.0, 0.0, 0.5]}


@dataclass(frozen=True)
class Units:
    """A system of units.

    Attributes:
        mass: Number of its mass units in 1 kg.
        length: Number of its length units in 1 m.
        time: Number of its time units in 1 s.
    """

    mass: float
    length: float
    time: float


_THOUSANDS = Units(1e3, 1e3, 1e3)  # g, mm, ms


@check("difference of configurations in 100 systems of units")
def units(trial: Trial) -> Cases:
    """Check that a motion does not depend on the system of units, such as g, mm and ms."""
    rng = np.random.default_rng(2)
    systems_of_units = [Units(*10.0 ** rng.uniform(-4.0, 4.0, 3)) for _ in range(99)]
    for name in trial.pick(("falling_cat",), tuple(_POSES)):
        system = load(name)
        # Each system of units needs a separate kernel; a cartpole kernel compiles quickly.
        selected = systems_of_units[: trial.pick(2, 99 if name == "cartpole" else 12, 99)]
        times = np.linspace(0.0, 2.0, 21)
        pose0 = _POSES[name]
        scene = Scene(system=system, times=times, pose0=pose0)
        growth = aba_reference(scene, samples(scene)).growth
        for method in (dop853(_UNITS_RTOL, _NO_ATOL), *(make(1e-2) for make in trial.fixed)):
            reference = trial.simulate(system, times=times, method=method, pose0=pose0)
            bound = _ROUNDING * EPS * growth * np.sqrt(reference.run.steps)
            errors = [_error_in_units(reference, trial, units) for units in [_THOUSANDS, *selected]]
            yield Case(f"{name}, {method.name}, g, mm, ms", errors[0], bound)
            yield Case(f"{name}, {method.name}, {len(selected)} others", max(errors), bound)


def _error_in_units(reference: Trajectory, trial: Trial, units: Units) -> float:
    """Compare a motion with the same motion simulated in other units."""
    system, method = reference.system, reference.scene.method
    start, converted = reference.scene.start, _convert(system, units)
    lengths = _lengths(system)
    factor = np.where(lengths, units.length, 1.0)
    r = system.r
    if isinstance(method, (RKMK4, Gauss)):
        method = replace(method, step=method.step * units.time)
    traj = trial.simulate(
        converted,
        x0=start.x * factor[r:],
        xdot0=start.xdot * factor[r:] / units.time,
        xi0=start.xi * factor[:r] / units.time,
        pose0=reference.scene.pose0,
        times=reference.t * units.time,
        method=method,
    )
    q = np.array(traj.q)
    for i in range(1, converted.model.njoints):
        joint = converted.model.joints[i]
        linear = min(joint.nq, int(lengths[joint.idx_v : joint.idx_v + joint.nv].sum()))
        q[:, joint.idx_q : joint.idx_q + linear] /= units.length
    gaps = [pin.difference(system.model, a, b) for a, b in zip(reference.q, q, strict=True)]
    return float(np.abs(gaps).max())


def _lengths(system: System) -> Array:
    """Return 1 for each velocity with the unit length/time, else 0; (n,)."""
    is_length = np.zeros(system.n)
    is_length[: system.group.linear] = 1.0
    for i in range(2, system.model.njoints):
        is_length[system.r + i - 2] = is_prismatic(system.model.joints[i])
    return is_length


def _convert(system: System, units: Units) -> System:
    """Convert a robot to other units."""
    model = system.model.copy()
    for i in range(1, model.njoints):
        placement, body = model.jointPlacements[i], model.inertias[i]
        model.jointPlacements[i] = pin.SE3(placement.rotation, placement.translation * units.length)
        model.inertias[i] = pin.Inertia(
            body.mass * units.mass,
            body.lever * units.length,
            body.inertia * units.mass * units.length**2,
        )
    model.gravity.linear = model.gravity.linear * units.length / units.time**2
    inertial = np.where(_lengths(system), units.mass, units.mass * units.length**2)
    model.armature = model.armature * inertial
    return load(model)


def euler_top(moments: Array, omega: Array, times: Array) -> tuple[Array, float]:
    """Compute the body rates of a free rigid body (L. D. Landau, E. M. Lifshitz, Mechanics, §37).

    Args:
        moments: Increasing, distinct principal moments of inertia, (3,) [kg·m²].
        omega: Body rates at time 0, (3,) [rad/s], not on a separatrix.
        times: Times, (T,) [s].
    Returns:
        Body rates (T, 3) [rad/s], and their period [s].
    """
    a, b, c = moments
    energy2, square = float(moments @ omega**2), float(moments**2 @ omega**2)
    order = [0, 1, 2]
    if square < energy2 * b:  # the body rotates about the axis of least moment, so exchange axes
        order, (a, c) = [2, 1, 0], (c, a)
    w1, w2, w3 = omega[order]
    most = np.sqrt(
        [
            (energy2 * c - square) / (a * (c - a)),
            (energy2 * c - square) / (b * (c - b)),
            (square - energy2 * a) / (c * (c - a)),
        ]
    )
    m = (b - a) * (energy2 * c - square) / ((c - b) * (square - energy2 * a))
    speed = np.sqrt((c - b) * (square - energy2 * a) / (a * b * c))
    # The order (3, 2, 1) is left-handed, but its moments decrease, so the sign is the same.
    sense = np.sign(w3)
    phase = ellipkinc(np.arctan2(w2 / most[1], w1 / most[0]), m)
    period = 4.0 * ellipk(m)
    sn, cn, dn, _ = ellipj(np.mod(phase + sense * speed * times, period), m)
    rates = np.empty((len(times), 3))
    rates[:, order] = np.stack([most[0] * cn, most[1] * sn, np.sign(w3) * most[2] * dn], axis=1)
    return rates, float(period / speed)


def cartpole_period(mass: float, lever: float, moment: float, gravity: float, most: float) -> float:
    """Compute the period of a pole that swings on a free cart.

    The substitution x = most · sin s makes the integrand smooth.

    Args:
        mass: Total mass of cart and pole [kg].
        lever: Mass of the pole times the distance of its centre from the hinge [kg·m].
        moment: Moment of inertia of the pole about the hinge [kg·m²].
        gravity: Gravitational acceleration [m/s²].
        most: Amplitude [rad], at which cart and pole are at rest.
    Returns:
        The period [s].
    """

    def integrand(s: Array) -> Array:
        x = most * np.sin(s)
        metric = moment - (lever * np.cos(x)) ** 2 / mass
        # cos x − cos most, without cancellation near the amplitude
        height = 2.0 * np.sin(0.5 * (most + x)) * np.sin(0.5 * (most - x))
        return np.asarray(most * np.cos(s) * np.sqrt(metric / (2.0 * lever * gravity * height)))

    # The midpoint rule converges exponentially for smooth periodic functions.
    count = 400
    middle = -0.5 * np.pi + np.pi * (np.arange(count) + 0.5) / count
    return 2.0 * np.pi * float(np.mean(integrand(middle)))


@dataclass(frozen=True)
class AbaReference:
    """Reference solution of a scene at some times.

    Attributes:
        full: Full simulation of the scene.
        motion: Reference solution at the times.
        size: Size of the motion, which serves as the unit of errors.
        growth: Factor by which a small perturbation grows until the last time.
    """

    full: FullState
    motion: FullMotion
    size: Size
    growth: float

    def error(self, traj: Trajectory, times: Array) -> float:
        """Return the largest error of a trajectory at `times`, relative to the motion's size."""
        states = traj(times)
        return self.error_of(FullMotion(x=states.x, q=states.q))

    def error_of(self, motion: FullMotion) -> float:
        """Return the largest error of a motion at the same times, relative to its size."""
        return self.full.distance(self.motion, motion).worst(self.size)


def aba_reference(scene: Scene, times: Array) -> AbaReference:
    """Integrate a scene with ABA at times (T,); raise IntegrationError if the integration fails."""
    full, start = FullState(scene), scene.start
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    motion = full.run(y0, times, *FINEST)
    growth = float(full.growth(y0, motion, times, 1e-10, 1e-12)[-1])
    return AbaReference(full, motion, full.size(motion), growth)


def samples(scene: Scene, count: int = 21) -> Array:
    """Return evenly spaced times of a scene, including its end, (count,) [s]."""
    return np.linspace(0.0, scene.end, count + 1)[1:]
