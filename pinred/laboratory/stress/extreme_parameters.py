"""Checks of robots and initial states with extreme parameters.

All run at the same tolerance. The number is the defect of a step by ABA, or the error against a
closed form, both in units of the tolerance.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.linalg import eigh
from scipy.spatial.transform import Rotation

from ...common.arrays import Array
from ...judge.reference_solution import FullMotion
from ...judge.step_defects import largest_defect
from ...reduction.pointwise_reduction import symmetric
from ...scene.scene import Scene
from ...simulation.trajectory import Trajectory
from ...system.load import load
from ...system.state_fields import State
from ...system.system import System
from ..bench.problems import build_tree, chain
from .accuracy_and_conservation import aba_reference, euler_top
from .check import DEFECT, EPS, PER_RADIAN, Case, Cases, Trial, check, dop853, tolerance

_RTOL = 1e-10
_MOMENTS = np.array([1.0, 2.0, 2.5])  # of the tops [kg·m²]
# Bounds on round-off, in units of eps.
_PER_MASS_RATIO = 20.0  # times the mass ratio
_PER_GIMBAL_RATIO = 10.0  # times the mass ratio of body and ring
_PER_CONDITION = 10.0  # times the condition number of the locked inertia
_OF_CHAOS = 2e3  # rates amplify the round-off of momenta


def _defect(trial: Trial, system: System, *, max_steps: int = 200, **options: Any) -> float:
    """Simulate, and return the largest defect of a step in tolerances."""
    traj = trial.simulate(system, **options, **tolerance(_RTOL))
    return largest_defect(traj, system, max_steps=max_steps) / _RTOL


# A momentum that is a small difference of large momenta has their round-off. Therefore the rate of
# a body that is lighter than its neighbours by a factor has a relative error of at least that
# factor times eps.
@check("defect of a step, and error of discs, per tolerance")
def mass_ratios(trial: Trial) -> Cases:
    """Vary mass ratios up to 1e8: light bases, light links, heavy loads."""
    moments = np.array([0.02, 0.05, 0.06])  # principal moments of a link of 1 kg [kg·m²]
    for ratio in trial.pick((1e2, 1e8), (1e2, 1e4, 1e6, 1e8)):
        bound = DEFECT + _PER_MASS_RATIO * EPS * ratio / _RTOL
        for index, name in enumerate(("base", "first link", "second link", "last link")):
            for factor, label in ((1.0 / ratio, "light"), (ratio, "heavy")):
                masses = np.ones(4)
                masses[index] = factor
                bodies = [body(m, [0.1, 0.02, 0.03], m * moments) for m in masses]
                defect = _defect(
                    trial,
                    tumbling_arm("ratios", bodies),
                    **TUMBLING,
                    duration=2.0,
                    max_steps=trial.pick(50, 200),
                )
                yield Case(f"{label} {name}, 1 : {ratio:.0e}, defect", defect, bound)
        for of_discs in ((1.0, 1.0 / ratio), (1.0 / ratio, 1.0)):
            yield _two_discs(trial, np.array(of_discs))


def _two_discs(trial: Trial, moments: Array) -> Case:
    """Compare two discs on a spring with the closed form over ten seconds, about 1 rad/s each."""
    discs = SprungDiscs(
        moments=moments,
        stiffness=np.array([40.0 * moments.min()]),
        x0=np.array([0.5]),
        rates=np.array([0.3, 0.3]),
        times=np.linspace(0.0, 10.0, 51),
    )
    traj = trial.simulate(discs.system, **discs.start, **discs.run, **tolerance(_RTOL))
    angle = np.sqrt(discs.stiffness[0] * (1.0 / moments).sum()) * discs.times[-1]
    bound = angle * (1.0 + _PER_MASS_RATIO * EPS * moments.max() / moments.min() / _RTOL)
    name = f"discs {moments[0]:g} : {moments[1]:g}, against the closed form"
    return Case(name, discs.error(traj) / _RTOL, bound)


@check("error after 1 s, or defect of a step, per tolerance")
def spins(trial: Trial) -> Cases:
    """Spin a single body, reaction wheels and a robot at up to 1e4 rad/s."""
    times = np.linspace(0.0, 1.0, 41)
    options = {"times": times, **tolerance(_RTOL)}
    for spin in trial.pick((1e4,), (1.0, 1e2, 1e4)):
        bound = PER_RADIAN * max(1.0, spin)
        omega = spin * np.array([0.3, 0.4, 0.85])
        rates, _ = euler_top(_MOMENTS, omega, times)
        traj = trial.simulate(single(_MOMENTS), xi0=omega, **options)
        error = np.abs(traj.xi - rates).max() / spin / _RTOL
        yield Case(f"Euler's top, {spin:g} rad/s, body rates", float(error), bound)

        expected = symmetric_top(2.0, 1.0, omega, times)
        traj = trial.simulate(single([2.0, 2.0, 1.0]), xi0=omega, **options)
        attitudes = np.array([pin.Quaternion(pose).matrix() for pose in traj.pose])
        error = np.abs(attitudes - expected).max() / _RTOL
        yield Case(f"symmetric top, {spin:g} rad/s, attitude", float(error), bound)

        defect = _defect(
            trial,
            load("reaction_wheel_satellite"),
            x0=[0.4, 0.0, 0.0, 0.0],
            xdot0=[0.2, spin, -0.8 * spin, 0.6 * spin],
            xi0=[0.0, 0.0, 0.0, 0.05, -0.04, 0.06],
            duration=1.0,
        )
        yield Case(f"wheels, {spin:g} rad/s, defect", defect, DEFECT)

        xi0 = np.append(np.zeros(3), omega)
        cat = load("falling_cat")
        defect = _defect(trial, cat, x0=[0.5, 0.2, -0.3], xi0=xi0, duration=10.0 / spin)
        yield Case(f"a spinning cat, {spin:g} rad/s, defect", defect, DEFECT)


@check("error of body rates, or defect of a step, per tolerance")
def flat_bodies(trial: Trial) -> Cases:
    """Flatten inertias to plates at the limit of the triangle inequality, and to thin rods."""
    times, omega = np.linspace(0.0, 10.0, 41), np.array([0.3, 0.4, 1.2])

    def arm(moments: Array) -> float:
        system = tumbling_arm("flat", [body(1.0, [0.1, 0.05, 0.0], moments)] * 4)
        return _defect(trial, system, **TUMBLING, duration=5.0)

    for short in trial.pick((0.0,), (1e-2, 1e-6, 1e-10, 0.0)):
        moments = np.array([1.0, 2.0, 3.0 * (1.0 - short)])
        rates, _ = euler_top(moments, omega, times)
        traj = trial.simulate(single(moments), xi0=omega, times=times, **tolerance(_RTOL))
        error = float(np.abs(traj.xi - rates).max()) / _RTOL
        bound = PER_RADIAN * float(np.linalg.norm(omega)) * float(times[-1])
        yield Case(f"plate, I₁ + I₂ − I₃ = {short:.0e} I₃, body rates", error, bound)
        yield Case(f"arm of plates, {short:.0e}, defect", arm(0.02 * moments), DEFECT)
    for thin in trial.pick((1e-10,), (1e-2, 1e-6, 1e-10)):
        moments = 0.02 * np.array([thin, 1.0, 1.0 + 0.5 * thin])
        yield Case(f"arm of rods, thin to {thin:.0e}, defect", arm(moments), DEFECT)


@check("defect of a step, per tolerance")
def straight_chains(trial: Trial) -> Cases:
    """Move nearly straight chains of thin rods, whose locked inertia is almost singular."""
    for thin in trial.pick((1e-2, 1e-8), (1e-2, 1e-4, 1e-6, 1e-8)):
        system = _chain_of_rods(thin)
        for bend in trial.pick((1e-1, 1e-4), (1e-1, 1e-2, 1e-4)):
            # The spin axis is normal to the chain, so only the bends cause spin along the chain.
            traj = trial.simulate(
                system,
                x0=bend * np.array([1.0, -0.7, 0.4]),
                xdot0=bend * np.array([0.5, 0.8, -0.6]),
                xi0=[0.0, 0.5, -0.7],
                duration=2.0,
                **tolerance(_RTOL),
            )
            condition = max(_condition(system, q) for q in traj.q[::20])
            bound = DEFECT + _PER_CONDITION * EPS * condition / _RTOL
            defect = largest_defect(traj, system) / _RTOL
            yield Case(f"thin to {thin:.0e}, bent by {bend:.0e}", defect, bound)


def _condition(system: System, q: Array) -> float:
    """Compute the condition number of the locked inertia with Pinocchio's CRBA."""
    upper = pin.crba(system.model, system.model.createData(), q)[:3, :3]
    return float(np.linalg.cond(symmetric(upper)))


def _chain_of_rods(thin: float) -> System:
    link = body(1.0, [0.25, 0.0, 0.0], 0.02 * np.array([thin, 1.0, 1.0]))
    joints = (pin.JointModelSpherical(), pin.JointModelRY(), pin.JointModelRZ(), pin.JointModelRY())
    return build_tree(
        "straight", [(j, [0.5 * (k > 0), 0.0, 0.0], link) for k, j in enumerate(joints)]
    )


@check("defect of a step, per tolerance")
def singular_shapes(trial: Trial) -> Cases:
    """Move through singular shapes of an arm: gimbal lock, and a stretched arm."""
    for light in trial.pick((1e-4,), (1e-1, 1e-2, 1e-3, 1e-4)):
        for miss in trial.pick((1e-3,), (0.0, 1e-3, 1e-1)):
            defect = _defect(
                trial,
                _gimbal(light),
                x0=[miss, 0.5 * np.pi - 0.4, -miss],
                xdot0=[0.3 * miss, 0.8, 0.2 * miss],
                xi0=[0.1, 0.0, 0.1, 0.2, -0.1, 0.3],
                duration=1.0,
            )
            bound = DEFECT + _PER_GIMBAL_RATIO * EPS / light / _RTOL
            yield Case(f"gimbal with rings of {light:.0e}, missed by {miss:.0e}", defect, bound)
    for joints in trial.pick((2,), (2, 3, 6)):
        bends = 0.3 * (-1.0) ** np.arange(joints)
        defect = _defect(trial, chain("spatial", joints), x0=bends, xdot0=-bends, duration=2.0)
        yield Case(f"arm of {joints} joints stretching out", defect, DEFECT)


def _gimbal(light: float) -> System:
    """Build two bodies on a gimbal; two of its axes align if the middle joint is at 90°."""
    heavy = body(1.0, [0.1, -0.2, 0.1], [0.1, 0.15, 0.2])
    ring = body(light, [0.0, 0.0, 0.0], [0.1 * light] * 3)
    joints = (pin.JointModelRX(), pin.JointModelRY(), pin.JointModelRZ())
    positions = [[0.3, 0.1, 0.0], [0.0] * 3, [0.0] * 3]
    links = list(zip(joints, positions, (ring, ring, heavy), strict=True))
    return build_tree("gimbal", [(pin.JointModelFreeFlyer(), [0.0] * 3, heavy), *links])


@check("error of discs, or defect of a step, per tolerance")
def stiff_springs(trial: Trial) -> Cases:
    """Move light links on stiff springs: fast small motions superposed on slow large ones."""
    for stiff in trial.pick((1e6,), (1e2, 1e4, 1e6)):
        # A light disc on a stiff spring, and a heavy disc on a soft one.
        discs = SprungDiscs(
            moments=np.array([1.0, 1e-3, 1.0]),
            stiffness=np.array([stiff, 1.0]),
            x0=np.array([1e-3, 0.5]),
            rates=np.array([0.4, 0.0, 0.2]),
            times=np.linspace(0.0, 1.0, 41),
        )
        traj = trial.simulate(discs.system, **discs.start, **discs.run, **tolerance(_RTOL))
        error = discs.error(traj, relative=True) / _RTOL
        fastest = float(np.sqrt(stiff / discs.moments.min()))
        yield Case(f"discs, {stiff:.0e} N·m/rad", error, PER_RADIAN * fastest)
    for stiff in trial.pick((1e4,), (1e2, 1e4, 1e6)):
        system = _light_arm(1e-2)
        defect = _defect(
            trial,
            system,
            x0=[0.3, -0.2, 0.4],
            xdot0=[0.5, 0.1, -0.2],
            xi0=[0.1, 0.0, 0.0, 0.2, -0.1, 0.3],
            duration=1.0,
            springs=dict.fromkeys(system.shape_names, (stiff, 0.1)),
        )
        yield Case(f"arm of 1 % of the mass, {stiff:.0e} N·m/rad", defect, DEFECT)


def _light_arm(mass: float) -> System:
    base = body(1.0, [0.0, 0.0, 0.0], [0.1, 0.15, 0.2])
    link = body(mass, [0.1, 0.0, 0.02], mass * np.array([0.01, 0.02, 0.025]))
    joints = (pin.JointModelRZ(), pin.JointModelRX(), pin.JointModelRY())
    arm = [(joint, [0.2, 0.0, 0.1], link) for joint in joints]
    return build_tree("springs", [(pin.JointModelFreeFlyer(), [0.0] * 3, base), *arm])


@check("defect of a step, per tolerance")
def long_chains(trial: Trial) -> Cases:
    """Move chains of up to 200 joints, planar and spatial."""
    sizes = (("planar", 50), ("planar", 200), ("spatial", 50), ("spatial", 200))
    for family, joints in trial.pick((("planar", 50),), sizes):
        rng = np.random.default_rng(joints)
        defect = _defect(
            trial,
            chain(family, joints),
            x0=rng.uniform(-0.3, 0.3, joints),
            xdot0=rng.uniform(-0.3, 0.3, joints),
            duration=0.5,
            max_steps=trial.pick(5, 20),
        )
        yield Case(f"{family}, {joints} joints", defect, DEFECT)


_DIRECTION = {
    "falling_cat": np.array([0.0, 0.0, 0.0, 0.6, -0.64, 0.48]),
    "planar_chain5": np.array([0.0, 0.0, 1.0]),
    "elroys_beanie": np.array([1.0]),
    "double_spherical_pendulum": np.array([1.0]),
}


@check("difference of the ends; error by ABA")
def zero_momentum(trial: Trial) -> Cases:
    """Check that kernels with and without momentum agree in the limit of zero momentum."""
    for name in trial.pick(("falling_cat",), tuple(_DIRECTION)):
        system, direction = load(name), _DIRECTION[name]
        assert system.initial is not None
        options: dict[str, Any] = {
            "x0": system.initial.x,
            "xdot0": system.initial.xdot,
            "times": np.array([1.0]),
            **tolerance(_RTOL),
        }
        # The sweep contains 1e-16 … 1e3 with both signs, and zero.
        most = trial.pick(2, 3)
        sizes = 10.0 ** np.arange(-16, most + 1)
        sweep = np.concatenate([-sizes[::-1], [0.0], sizes])
        many = trial.simulate_many(system, momentum=sweep[:, None] * direction, **options)
        ends = [many[k] for k in range(len(sweep))]
        at_zero = ends[len(sizes)]
        # The effect of smaller momenta is bounded by the effect of 1e-3, which ABA measures.
        effect = _effect_by_aba(Scene(system=system, momentum=1e-3 * direction, **options), options)
        for k in np.flatnonzero(np.abs(sweep) <= 1e-3):
            jump = float(np.abs(ends[k].x - at_zero.x).max())
            bound = 2.0 * effect * abs(sweep[k]) / 1e-3 + _RTOL
            yield Case(f"{name}, momentum {sweep[k]:.0e}, from that at zero", jump, bound)
        compared = trial.pick((0.0, 1.0), (0.0, 1e-16, 1e-8, 1e-2, 1.0))
        for k in np.flatnonzero(np.isin(sweep, compared)):
            scene = Scene(system=system, momentum=sweep[k] * direction, **options)
            reference = aba_reference(scene, scene.report_times)
            error = reference.error_of(FullMotion(x=ends[k].x, q=ends[k].q))
            bound = 10 * _RTOL * reference.growth
            yield Case(f"{name}, momentum {sweep[k]:.0e}, by ABA", error, bound)


def _effect_by_aba(scene: Scene, options: dict[str, Any]) -> float:
    """Compute with ABA the change of the final shape that the momentum causes."""
    scenes = (Scene(system=scene.system, momentum=0, **options), scene)
    a, b = (aba_reference(case, case.report_times).motion.x[-1] for case in scenes)
    return float(np.abs(a - b).max())


@check("error against closed forms, relative, per tolerance")
def time_scales(trial: Trial) -> Cases:
    """Combine very short and very long time scales, in one motion and separately."""
    for ratio in trial.pick((1e2,), (1e2, 1e3, 1e4)):
        discs = SprungDiscs(
            moments=np.array([1.0, 2.0, 1.5]),
            stiffness=np.array([ratio**2, 1.0]),
            x0=np.array([0.3 / ratio, 0.4]),
            rates=np.array([0.2, 0.1, -0.3]),
            times=np.linspace(0.0, 20.0, 101),
        )
        starts = {name: value[None] for name, value in discs.start.items()}
        many = trial.simulate_many(discs.system, **starts, **discs.run, **tolerance(_RTOL))
        error = discs.error(many[0], relative=True) / _RTOL
        bound = PER_RADIAN * ratio * float(discs.times[-1])
        yield Case(f"two springs, {ratio:.0e} apart", error, bound)
    # Each case rotates by the same angle, over a very short or very long time.
    turn = np.array([0.5, 0.7, 1.6])
    for seconds in trial.pick((1e-9, 1e9), (1e-12, 1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e9, 1e12)):
        times, omega = seconds * np.linspace(0.0, 10.0, 21), turn / seconds
        rates, _ = euler_top(_MOMENTS, omega, times)
        method = dop853(0.1 * _RTOL, 1e-30)
        traj = trial.simulate(single(_MOMENTS), xi0=omega, times=times, method=method)
        error = float(np.abs(traj.xi - rates).max() / np.abs(omega).max())
        bound = PER_RADIAN * 10.0 * float(np.linalg.norm(turn))
        yield Case(f"a top of some rad per {seconds:.0e} s", error / _RTOL, bound)


# Factor of the initial rates, and a duration [s] over which chaos amplifies any initial error.
_CHAOTIC: dict[str, tuple[float, float]] = {
    "planar_chain5": (5.0, 100.0),
    "falling_cat": (5.0, 100.0),
    "satellite_two_arms": (5.0, 100.0),
    "double_spherical_pendulum": (4.0, 50.0),
}


@check("defect of a step, per tolerance")
def chaos(trial: Trial) -> Cases:
    """Measure chaotic motions by the defects of steps: final errors carry no information."""
    for name in trial.pick(("planar_chain5",), tuple(_CHAOTIC)):
        system, (faster, duration) = load(name), _CHAOTIC[name]
        assert system.initial is not None
        start = system.initial
        for rtol in trial.pick((1e-10,), (1e-6, 1e-10, 1e-13)):
            for method in trial.methods(rtol):
                traj = trial.simulate(
                    system,
                    x0=start.x,
                    xdot0=faster * start.xdot,
                    xi0=faster * start.xi,
                    times=np.array([duration]),
                    method=method,
                    **tolerance(rtol),
                )
                defect = largest_defect(traj, system) / rtol
                bound = DEFECT + _OF_CHAOS * EPS / rtol
                yield Case(f"{name}, {traj.run.method}, {duration:g} s, {rtol:.0e}", defect, bound)


def symmetric_top(moment: float, axial: float, omega: Array, times: Array) -> Array:
    """Compute the attitude of a free body with moments (moment, moment, axial).

    The attitude is R(t) = exp(t J/I) exp(t ω₃(1 − C/I) e₃), with the identity at time 0.

    Args:
        moment: Transverse moment of inertia I [kg·m²].
        axial: Axial moment of inertia C [kg·m²].
        omega: Body rates at time 0, (3,) [rad/s].
        times: Times, (T,) [s].
    Returns:
        (T, 3, 3) rotation matrices.
    """
    J = np.array([moment, moment, axial]) * omega
    spin = np.array([0.0, 0.0, (1.0 - axial / moment) * omega[2]])
    turns = [Rotation.from_rotvec(np.outer(times, rate)) for rate in (J / moment, spin)]
    return np.asarray((turns[0] * turns[1]).as_matrix())


def body(mass: float, com: ArrayLike, moments: ArrayLike) -> pin.Inertia:
    """Return a body with centre of mass `com` (3,) and principal moments (3,) along its axes."""
    return pin.Inertia(mass, np.asarray(com, dtype=float), np.diag(np.asarray(moments, float)))


def tumbling_arm(name: str, bodies: Sequence[pin.Inertia]) -> System:
    """Build a free base with an arm of three joints about different axes, from four bodies."""
    joints = (pin.JointModelFreeFlyer(), pin.JointModelRX(), pin.JointModelRY(), pin.JointModelRZ())
    position = [0.3, 0.1, -0.2]
    return build_tree(name, [(j, position, link) for j, link in zip(joints, bodies, strict=True)])


TUMBLING: dict[str, Any] = {  # initial state of `tumbling_arm`
    "x0": [0.3, -0.5, 0.4],
    "xdot0": [0.6, -0.4, 0.8],
    "xi0": [0.1, 0.2, -0.1, 0.3, -0.2, 0.4],
}


def single(moments: ArrayLike) -> System:
    """Build a rigid body that rotates about its centre of mass."""
    z = np.zeros(3)
    return build_tree("body", [(pin.JointModelSpherical(), z, body(1.0, z, moments))])


@dataclass(frozen=True)
class SprungDiscs:
    """Discs and their initial state.

    Attributes:
        moments: Moments of inertia, (m + 1,) [kg·m²].
        stiffness: Stiffness of the springs, which are relaxed at zero twist, (m,) [N·m/rad].
        x0: Initial twists of the springs, (m,) [rad].
        rates: Initial rates of the first disc and of the twists, (m + 1,) [rad/s].
        times: Times at which the motion is compared, (T,) [s].
    """

    moments: Array
    stiffness: Array
    x0: Array
    rates: Array
    times: Array

    @property
    def system(self) -> System:
        """The discs as a robot; the first is the base."""
        z, joint = np.zeros(3), pin.JointModelRZ()
        links = [(joint, z, body(1.0, z, [0.6 * i, 0.6 * i, i])) for i in self.moments.tolist()]
        return build_tree("discs", links)

    @property
    def start(self) -> dict[str, Array]:
        """Options of Scene for the initial state."""
        return {"x0": self.x0, "xdot0": self.rates[1:], "xi0": self.rates[:1]}

    @property
    def run(self) -> dict[str, Any]:
        """Options of Scene for times and springs."""
        names = self.system.shape_names
        pairs = [(k, 0.0) for k in self.stiffness]
        return {"times": self.times, "springs": dict(zip(names, pairs, strict=True))}

    def error(self, motion: Trajectory | State, *, relative: bool = False) -> float:
        """Return the largest error against the closed form [rad].

        relative: divide the error of each twist by the twist's largest value.
        """
        first, twists = self._motion()
        size = np.abs(twists).max(axis=0) if relative else 1.0
        errors = np.abs(motion.x - twists) / size
        return float(max(errors.max(), np.abs(motion.pose[:, 0] - first).max()))

    def _motion(self) -> tuple[Array, Array]:
        """Compute the motion by normal modes.

        Returns:
            Angle of the first disc (T,), which is 0 at time 0, and twists (T, m) [rad].
        """
        m = len(self.stiffness)
        absolute = np.tril(np.ones((m + 1, m + 1)))  # maps the first angle and twists to all angles
        H = absolute.T @ np.diag(self.moments) @ absolute
        metric = H[1:, 1:] - np.outer(H[0, 1:], H[0, 1:]) / H[0, 0]
        square, modes = eigh(np.diag(self.stiffness), metric)
        omega = np.sqrt(square)
        modal_x0, modal_rates = modes.T @ metric @ self.x0, modes.T @ metric @ self.rates[1:]
        angle = np.outer(self.times, omega)
        twists = (modal_x0 * np.cos(angle) + modal_rates / omega * np.sin(angle)) @ modes.T
        steady = float(H[0] @ self.rates) / H[0, 0]
        first = steady * self.times - (twists - self.x0) @ H[0, 1:] / H[0, 0]
        return np.asarray(first), np.asarray(twists)
