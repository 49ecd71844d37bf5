"""Cyclic joints and symmetric balls: joints of which a momentum is constant.

Neither the inertia nor the potential depends on the value of a cyclic hinge or slide. Its momentum
is constant, and its angle follows by quadrature (Routh).  Examples are reaction wheels and rotors.

A symmetric body that rotates within itself about its ball moves no mass, so its momentum along the
axis of symmetry n, in its own axes, is constant: π · n for a body of revolution about n, and all of
π for a spherical rotor.  A spherical rotor has equal moments of inertia and its centre of mass at
the ball. The other bodies feel only its momentum ℓ = R π in the axes of the parent, which obeys ℓ̇
= s × ℓ with the rate s of the ball in these axes; without armature ℓ̇ = ℓ × ω for the parent's ω.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from ..common.arrays import Array, read_only
from ..common.errors import SymmetryError
from ..system.coordinates import PlacedJoint
from ..system.joints import axes_of
from ..system.loops.loop_assembly import loop_rates
from ..system.system import System, radius_of_gyration
from .pointwise_reduction import PointwiseReduction
from .potential import pivot_weight

_SAMPLES = 3  # number of random shapes at which the dependence is checked
_NO_DEPENDENCE = 1e-12  # largest work that counts as zero, relative to the joint's typical energy
_ROUND_OFF = 2e-14  # largest round-off of work, relative to the subtree's inertia about the root


def cyclic_joints(
    red: PointwiseReduction, touched: Collection[int] = (), *, pushed: bool = False
) -> tuple[int, ...]:
    """Find the joints whose angle changes neither the mass matrix nor the potential.

    If gravity rotates a pivoted base, the centre of mass must not move with the joint.  If gravity
    breaks the symmetry otherwise, there is no potential on shape space, and no joint is cyclic.

    Args:
        red: Reduction of the system.
        touched: Joints on which forces act, or whose position enters another quantity.
        pushed: Whether a force acts on the base.  Momenta are then measured in the frame of the
            centre of mass. The momentum of a joint changes if the joint moves this frame along
            the group.
    Returns:
        Indices of the cyclic joints.
    """
    system = red.system
    r, m, k = system.r, system.m, system.group.linear
    rng = np.random.default_rng(0)
    depends = np.zeros(m, dtype=bool)
    depends[[*touched, *system.space.ball_v.tolist()]] = True
    data = system.sorted_data
    heavy = pivot_weight(system).any()
    for _ in range(_SAMPLES):
        if depends.all():
            break
        at = red.at(system.space.random(rng, 3.0))
        q = system.sorted_q(system.group.identity(), at.x)
        com_derivative = system.on_shape(pin.jacobianCenterOfMass(system.sorted_model, data, q))[
            :, r:
        ]
        unit, limit = _usual_rates(system, data, at.mass_matrix)
        b, s = unit[:r, None], unit[r:, None]
        dIA = np.einsum("ij,jbc->ibc", at.locked_inertia, at.dA)
        for derivative, rates in ((at.dI, b * b.T), (dIA, b * s.T), (at.dM, s * s.T)):
            forces = np.abs(derivative) * rates[:, :, None] * unit[r:]
            depends |= (forces > limit).reshape(-1, m).any(axis=0)
        if pushed:
            work = np.abs(at.mass_matrix[:k, r:]) * unit[:k, None] * unit[r:]
            depends |= (work > limit).any(axis=0)
        gravity = float(np.linalg.norm(system.gravity))
        if heavy:
            moment = system.mass * np.abs(com_derivative).max(axis=0)
            depends |= gravity * moment * unit[r:] > limit + gravity * limit
            continue
        try:
            work = np.abs(red.potential_gradient(at.x)) * unit[r:]
            depends |= work > limit + gravity * limit
        except SymmetryError:
            depends[:] = True
    return tuple(np.flatnonzero(~depends).tolist())


def _usual_rates(system: System, data: pin.Data, H: Array) -> tuple[Array, Array]:
    """Return typical rates, (n,), and the largest work per shape joint that counts as zero, (m,).

    A typical rate is 1 rad/s, or a speed that covers the robot's length in a second.  The limit is
    a fraction of the kinetic energy of the joint, not of the robot, so that it suits light and
    heavy joints.  Round-off scales with the subtree's inertia about the root, so that the limit is
    lower for small and light subtrees near the root.  `data` must contain the joint placements.
    """
    model, r = system.sorted_model, system.r
    root = data.oMi[1].translation
    ends = np.zeros(model.njoints)  # greatest distance from the root in each subtree [m]
    for i in range(model.njoints - 1, 0, -1):
        place = data.oMi[i].act(model.inertias[i].lever)
        distance = float(np.linalg.norm(place - root)) + radius_of_gyration(model.inertias[i])
        ends[i] = max(ends[i], distance, float(np.linalg.norm(data.oMi[i].translation - root)))
        ends[model.parents[i]] = max(ends[model.parents[i]], ends[i])
    reach = float(ends[1]) or 1.0
    unit = np.ones(model.nv)
    for i in range(1, model.njoints):
        joint = model.joints[i]
        slides = ~axes_of(joint)[3:].any(axis=0)
        unit[joint.idx_v : joint.idx_v + joint.nv][slides] = reach
    bodies = [i for i in range(2, model.njoints) for _ in range(model.joints[i].nv)]
    terms = np.array([data.mass[i] * ends[i] ** 2 for i in bodies])
    if system.coupled is not None:
        terms = system.sizes_on_shape(np.append(np.zeros(r), terms))[r:]
        unit = np.append(unit[:r], unit[r:][system.coupled.leads])
    energies = (np.diag(H) * unit**2)[r:]
    return unit, np.maximum(_NO_DEPENDENCE * energies, _ROUND_OFF * terms)


def cyclic_of(system: System, touched: frozenset[int], *, pushed: bool) -> tuple[int, ...]:
    """Return the cyclic joints of a system; the result is cached (see `cyclic_joints`).

    The joints of closed loops are not cyclic.
    """
    return system.workspace(
        (cyclic_of, touched, pushed),
        lambda: cyclic_joints(
            PointwiseReduction(system.open_tree()), touched | loop_rates(system), pushed=pushed
        ),
    )


_COMMON = 1e-9  # largest difference of unit vectors that count as one axis
_ALIGNED = 1e-12  # largest entry of a unit vector that counts as zero


@dataclass(frozen=True)
class SymmetricBall:
    """A ball whose body is symmetric about axes through the ball.

    Attributes:
        joint: The ball.
        axis: Unit axis of symmetry in the axes of the body, (3,); None for a spherical rotor, whose
            axes are all axes of symmetry.
    """

    joint: PlacedJoint
    axis: Array | None

    def __str__(self) -> str:
        if self.axis is None:
            return f"spherical rotor {self.joint.name}: its momentum in its own axes"
        axis = ", ".join(f"{c:g}" for c in self.axis)
        return f"body of revolution on {self.joint.name}: its momentum about ({axis})"


def symmetric_balls(system: System, touched: Collection[int] = ()) -> tuple[SymmetricBall, ...]:
    """Find the balls whose body has an axis of symmetry about which no torque acts.

    The body must be the last of its branch, with the axis through the ball, and in no closed loop.

    Args:
        system: The system.
        touched: Rates on which forces act, or whose joints enter another quantity.
    Returns:
        The symmetric balls, in the order of the shape.
    """
    if not system.space.balls:
        return ()
    reach, carriers = _reach(system), {*system.sorted_model.parents.tolist()[1:]}
    affected, balls = {*touched} | loop_rates(system), []
    for ball in system.space.balls:
        i = system.sorted_joints[ball.v.start]
        if i in carriers:
            continue
        symmetric, axis = _axis_of_symmetry(system, system.sorted_model.inertias[i], reach)
        rates = [ball.v.start + k for k in range(3) if axis is None or abs(axis[k]) > _ALIGNED]
        if symmetric and not {*rates} & affected:
            balls.append(SymmetricBall(ball, axis))
    return tuple(balls)


def symmetric_balls_of(system: System, touched: frozenset[int]) -> tuple[SymmetricBall, ...]:
    """Return the symmetric balls of a system; the result is cached (see `symmetric_balls`)."""
    return system.workspace((symmetric_balls_of, touched), lambda: symmetric_balls(system, touched))


def always_symmetric(
    balls: Collection[SymmetricBall], other: Collection[SymmetricBall]
) -> tuple[SymmetricBall, ...]:
    """Return the balls of two systems of one shape that are symmetric about common axes."""
    axes = {ball.joint.name: ball.axis for ball in other}
    common = []
    for ball in balls:
        name, axis = ball.joint.name, ball.axis
        if name not in axes:
            continue
        other_axis = axes[name]
        if axis is None:
            common.append(replace(ball, axis=other_axis))
        elif other_axis is None or np.abs(axis - other_axis).max() <= _COMMON:
            common.append(ball)
    return tuple(common)


def rotors_among(balls: Collection[SymmetricBall]) -> tuple[int, ...]:
    """Return the indices of the first rates of the spherical rotors among symmetric balls."""
    return tuple(ball.joint.v.start for ball in balls if ball.axis is None)


def axial_among(balls: Collection[SymmetricBall]) -> tuple[int, ...]:
    """Return the indices of the rates along axes of symmetry that are axes of the joint.

    About other axes π · n is constant, too, but it is no entry of π.
    """
    axes = [(ball.joint.v.start, ball.axis) for ball in balls if ball.axis is not None]
    return tuple(v + int(np.argmax(axis)) for v, axis in axes if axis.max() == 1.0)


def _axis_of_symmetry(system: System, body: pin.Inertia, reach: float) -> tuple[bool, Array | None]:
    """Return whether a body is symmetric about its origin, and the only axis if there is one.

    Args:
        system: The system.
        body: Inertia of the body in the axes of its joint.
        reach: Size of the robot [m].
    Returns:
        Whether there is an axis of symmetry; the axis, (3,), or None if all axes are.
    """
    moments, axes = np.linalg.eigh(body.inertia)
    limit = max(_NO_DEPENDENCE * float(moments[-1]), _ROUND_OFF * body.mass * reach**2)
    gravity = float(np.linalg.norm(system.gravity))
    # An offset couples the attitude to the motion of the ball, and gravity does work on it.
    offset = max(reach, gravity / (1.0 + gravity)) * body.mass * body.lever
    if np.ptp(moments) <= limit and np.linalg.norm(offset) <= limit:
        return True, None
    # The moments are sorted, so the single one is the first or the last.
    for single, equal in ((2, moments[:2]), (0, moments[1:])):
        n = _snapped(axes[:, single])
        if np.ptp(equal) <= limit and np.linalg.norm(np.cross(offset, n)) <= limit:
            return True, n
    if np.ptp(moments) <= limit:  # a sphere whose centre is away from the ball
        return True, _snapped(offset / np.linalg.norm(offset))
    return False, None


def _snapped(axis: Array) -> Array:
    """Return a unit vector without round-off near zero, with its largest entry positive."""
    axis = np.where(np.abs(axis) <= _ALIGNED, 0.0, axis)
    axis = axis * np.sign(axis[np.argmax(np.abs(axis))]) / np.linalg.norm(axis)
    return read_only(axis + 0.0)


def _reach(system: System) -> float:
    """Return the distance of the farthest body from the root at the neutral shape [m]."""
    model, data = system.sorted_model, system.sorted_data
    q = system.sorted_q(system.group.identity(), system.space.neutral)
    pin.forwardKinematics(model, data, q)
    root = data.oMi[1].translation
    return max(
        float(np.linalg.norm(data.oMi[i].act(body.lever) - root)) + radius_of_gyration(body)
        for i, body in enumerate(model.inertias.tolist())
        if i > 0
    )
