"""Robots generated in memory, closed forms, and solutions by ABA: the other side of each check."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.linalg import eigh
from scipy.special import ellipj, ellipk, ellipkinc

from ...common.arrays import Array
from ...judge.distances import FullMotion, Size
from ...judge.reference_solution import FINEST, FullState
from ...scene.scene import Scene
from ...simulation.trajectory import Trajectory
from ...system.state_fields import State
from ...system.system import System
from ..bench.problems import build_tree


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
    return np.array([_rotation(t * J / moment) @ _rotation(t * spin) for t in times])


def _rotation(vector: Array) -> Array:
    """Return the rotation matrix of a rotation vector (3,) by Rodrigues' formula."""
    angle = float(np.linalg.norm(vector))
    if angle == 0.0:
        return np.eye(3)
    x, y, z = vector / angle
    K = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K)


def discs(
    moments: Array, stiffness: Array, x0: Array, rates: Array, times: Array
) -> tuple[Array, Array]:
    """Compute the motion of m + 1 discs on one axis by normal modes.

    Args:
        moments: Moments of inertia, (m + 1,) [kg·m²].
        stiffness: Stiffness of the springs between neighbours, (m,) [N·m/rad].
        x0: Twists of the springs at time 0, (m,) [rad].
        rates: Rates of the first disc and of the twists at time 0, (m + 1,) [rad/s].
        times: Times, (T,) [s].
    Returns:
        Angle of the first disc (T,), which is 0 at time 0, and twists (T, m) [rad].
    """
    m = len(stiffness)
    absolute = np.tril(np.ones((m + 1, m + 1)))  # maps the first angle and the twists to all angles
    H = absolute.T @ np.diag(moments) @ absolute
    metric = H[1:, 1:] - np.outer(H[0, 1:], H[0, 1:]) / H[0, 0]
    square, modes = eigh(np.diag(stiffness), metric)
    omega = np.sqrt(square)
    modal_x0, modal_rates = modes.T @ metric @ x0, modes.T @ metric @ rates[1:]
    angle = np.outer(times, omega)
    twists = (modal_x0 * np.cos(angle) + modal_rates / omega * np.sin(angle)) @ modes.T
    steady = float(H[0] @ rates) / H[0, 0]
    first = steady * times - (twists - x0) @ H[0, 1:] / H[0, 0]
    return np.asarray(first), np.asarray(twists)


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


def disc_stack(moments: Sequence[float]) -> System:
    """Build discs on one axis; the first is the base."""
    z = np.zeros(3)
    return build_tree(
        "discs", [(pin.JointModelRZ(), z, body(1.0, z, [0.6 * i, 0.6 * i, i])) for i in moments]
    )


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
        return disc_stack(self.moments.tolist())

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
        first, twists = discs(self.moments, self.stiffness, self.x0, self.rates, self.times)
        size = np.abs(twists).max(axis=0) if relative else 1.0
        errors = np.abs(motion.x - twists) / size
        return float(max(errors.max(), np.abs(motion.pose[:, 0] - first).max()))


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
