"""The map from initial states to reduced initial conditions, as machine code for one robot.

An initial state consists of pose, shape, shape rate, and body twist or momentum.  The result
contains the canonical momenta π in the frame of the centre of mass, and the angular momentum about
the centre of mass in the body frame and in the fixed frame.  It also contains the initial position
and velocity of the centre of mass.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import casadi as ca
import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.machine_code import NativeCode, load_object
from ..common.memo import once
from ..common.object_cache import ObjectCache, cache_key
from ..reduction.base_parts import BaseParts
from ..reduction.pointwise_reduction import mass_matrix_at
from ..reduction.potential import translations
from ..reduction.tree.all_joints import joint_values
from ..reduction.tree.articulated_sweep import sweep
from ..reduction.tree.body_frames import bodies_of
from ..reduction.tree.free_bodies import NOTHING, Freed, free_numbers, total_mass, with_free
from ..reduction.tree.momenta import centre_of_mass, momenta
from ..reduction.tree.scalars import Scalar
from ..system.system import System, nominal
from .build import model_bytes
from .kernel import evaluate
from .machine.native import compile_object
from .reduced_graph import BaseGraph
from .reference_state import length_of, perturb_parameters, steps_of
from .validation import explain_ill_scaling, require_agreement

TwistOrMomentum = Literal["xi", "mu"]
_NAME = "initial_conditions"


@dataclass(frozen=True)
class InitialConditions:
    """Reduced initial conditions of N flows.

    Attributes:
        pi: Canonical momenta in the frame of the centre of mass, (N, m).
        about: Angular momenta about the centre of mass in the body frame, (N, a) [kg·m²/s].
        fixed: The same angular momenta in the fixed frame, (N, a) [kg·m²/s].
        c0: Centres of mass in the root joint's fixed frame, (N, k) [m].
        v0: Velocities of the centres of mass in the same frame, (N, k) [m/s].
    """

    pi: Array
    about: Array
    fixed: Array
    c0: Array
    v0: Array


@dataclass(frozen=True)
class InitialConditionsKernel:
    """Machine code that maps initial states to reduced initial conditions.

    Attributes:
        system: The system; its own body parameters are used unless a call passes other values.
        freed: Variable body parameters.
        code: The machine code.
    """

    system: System
    freed: Freed
    code: NativeCode

    def __call__(
        self, pose: Array, x: Array, xdot: Array, motion: Array, numbers: Array | None = None
    ) -> InitialConditions:
        """Compute the reduced initial conditions of N initial states.

        Args:
            pose: Poses, (N, size).
            x: Shapes, (N, nx) [rad | m | 1].
            xdot: Shape rates, (N, m).
            motion: Body twists or body momenta, (N, r).
            numbers: Values of the variable body parameters, (freed.size,) or (N, freed.size); by
                default those of the system.
        Returns:
            The initial conditions.
        """
        states = np.concatenate([pose, x, xdot, motion], axis=1)
        return self.split(self.evaluate(states, numbers))

    @cached_property
    def size(self) -> int:
        """Number of outputs."""
        return self.system.m + 2 * self.system.r

    @cached_property
    def own_numbers(self) -> Array:
        """Values of the variable body parameters of the system; (1,) without any."""
        return free_numbers(self.system, self.freed) if self.freed else np.zeros(1)

    def evaluate(
        self, states: Array, numbers: Array | None = None, out: Array | None = None
    ) -> Array:
        """Compute the outputs of the kernel, (N, size).

        Args:
            states: Pose, shape, shape rate and body twist or momentum of N states, (N, …).
            numbers: Values of the variable body parameters, as for a call.
            out: Array (N, size) for the outputs; a new one if None.
        Returns:
            The outputs.
        """
        if numbers is None:
            numbers = self.own_numbers
        return evaluate(self.code.address, numbers, states, self.size, out)

    @cached_property
    def about(self) -> slice:
        """Indices of the outputs `about` of InitialConditions."""
        m, r, k = self.system.m, self.system.r, self.system.group.linear
        return slice(m, m + r - k)

    def split(self, values: Array) -> InitialConditions:
        """Split the outputs of the kernel, (N, size)."""
        m, r, k = self.system.m, self.system.r, self.system.group.linear
        fixed, c0, v0 = m + r - k, m + 2 * (r - k), m + 2 * (r - k) + k
        return InitialConditions(
            pi=values[:, :m],
            about=values[:, self.about],
            fixed=values[:, fixed:c0],
            c0=values[:, c0:v0],
            v0=values[:, v0:],
        )


def initial_conditions_kernel(
    system: System, given: TwistOrMomentum, freed: Freed = NOTHING
) -> InitialConditionsKernel:
    """Return the validated kernel of initial conditions.

    Args:
        system: The system.
        given: Whether initial states contain a body twist ("xi") or a body momentum ("mu").
        freed: Variable body parameters.
    Returns:
        The kernel, compiled once.
    Raises:
        KernelMismatch: The kernel disagrees with Pinocchio.
        ModelError: The kernel disagrees because the system is ill-scaled.
    """

    def make() -> InitialConditionsKernel:
        key = cache_key(
            model_bytes(system, freed), f"initial conditions from {given}{freed.steps or ''}"
        )
        code = ObjectCache().get_or_compile(
            key,
            lambda: compile_object(initial_conditions_graph(system, given, freed), _NAME),
            f"the initial conditions of '{system.name}'",
        )
        kernel = InitialConditionsKernel(system, freed, load_object(code, _NAME))
        with explain_ill_scaling(system):
            _validate(kernel, given)
            if freed:  # also validate with other values of the variable parameters
                _validate(replace(kernel, system=perturb_parameters(system, freed)), given)
        return kernel

    kernel = once(
        nominal(system) if freed else system, (InitialConditionsKernel, given, freed), make
    )
    return replace(kernel, system=system) if freed else kernel


def initial_conditions_graph(
    system: System, given: TwistOrMomentum, freed: Freed = NOTHING
) -> ca.Function:
    """Build the map from initial states to reduced initial conditions.

    Args:
        system: The system.
        given: Whether initial states contain a body twist ("xi") or a body momentum ("mu").
        freed: Variable body parameters.
    Returns:
        Function of (pose, x, ẋ, ξ or μ) and of the variable body parameters.
    """
    numbers = ca.SX.sym("numbers", freed.size)
    bodies = with_free(bodies_of(system), freed, ca.vertsplit(numbers) if freed else [])
    mass = total_mass(bodies) if freed.inertias else system.mass
    group, m, r = system.group, system.m, system.r
    k = group.linear
    pose, x = ca.SX.sym("pose", group.size), ca.SX.sym("x", system.nx)
    xdot = ca.SX.sym("xdot", m)
    motion = ca.SX.sym("motion", r)
    base = BaseGraph(system, BaseParts(attitude=group.size - k), None, mass=mass)
    joints = joint_values(system, ca.vertsplit(x) if m else [])
    com = centre_of_mass(bodies, joints)
    p = momenta(system, x, ca.vertcat(motion, xdot), bodies=bodies)
    mu = ca.vertsplit(p[:r] if given == "xi" else motion)
    about = base.about(com, mu)
    velocity = [P / mass for P in mu[:k]]
    if given == "xi":
        carried = ca.vertcat(*velocity, ca.SX(r - k + m, 1))
        pi: list[Scalar] = (
            ca.vertsplit((p - momenta(system, x, ca.densify(carried), bodies=bodies))[r:])
            if m
            else []
        )
    else:
        armature = float(system.model.armature[0])
        result = sweep(
            bodies, joints, [0.0] * m, [0.0] * k + about, group.axes, armature,
            dict(enumerate(ca.vertsplit(xdot))) if m else {}, coupled=system.coupled,
        )  # fmt: skip
        pi = result.pi
    fixed, offset, velocity = (
        base.turned_angular(about), base.turned(base.along(com)), base.turned(velocity)
    )  # fmt: skip
    c0 = [a + b for a, b in zip(ca.vertsplit(pose)[:k], offset, strict=True)]
    conditions = ca.vertcat(ca.SX(0, 1), *pi, *about, *fixed, *c0, *velocity)
    attitude = ca.vertsplit(pose)[k:]
    if attitude:
        conditions = ca.substitute(conditions, ca.vertcat(*base.attitude), ca.vertcat(*attitude))
    inputs = ca.vertcat(pose, x, xdot, motion)
    return ca.Function(
        _NAME,
        [inputs, numbers if freed else ca.SX.sym("none")],
        [ca.densify(conditions)],
        {"cse": True},
    )


def _validate(kernel: InitialConditionsKernel, given: TwistOrMomentum) -> None:
    """Compare a kernel with Pinocchio's mass matrix at a random state in the robot's own units."""
    system, rng = kernel.system, np.random.default_rng(0)
    group, r = system.group, system.r
    k = group.linear
    steps = steps_of(system, length_of(system))
    pose = group.exp(steps[:r] * rng.uniform(-1.0, 1.0, r))
    displacement = steps[r:] * rng.uniform(-2.0, 2.0, system.m)
    x = system.space.integrate(system.space.neutral, displacement)
    xi, xdot = np.split(steps * rng.normal(size=system.n), [r])
    data = system.sorted_data
    H = mass_matrix_at(system, system.sorted_model, data, group.identity(), x)
    mu = H[:r] @ np.concatenate([xi, xdot])
    motion = xi if given == "xi" else mu
    values = kernel(*(column[None] for column in (pose, x, xdot, motion)))
    relative = xi.copy()
    relative[:k] -= mu[:k] / system.mass
    v = np.concatenate([relative, xdot])
    q = system.sorted_q(pose, x)
    pin.centerOfMass(system.sorted_model, data, q, system.sorted_v(xi, xdot))
    root = system.model.jointPlacements[1]
    c = translations(system).T @ root.actInv(pin.centerOfMass(system.sorted_model, data, q))
    angular_momentum = H[k:r] @ v
    # A momentum input has the round-off of its summands, which propagates to the twist.
    velocity = np.abs(np.concatenate([xi, xdot]))
    terms = np.abs(H) @ velocity
    largest = [terms[:k].max(initial=0.0), terms[k:r].max(initial=0.0)]
    velocity[:r] += np.abs(np.linalg.inv(H[:r, :r])) @ np.repeat(largest, [k, r - k])
    terms = np.abs(H) @ velocity
    distance = np.abs(c).sum() + np.abs(pose[:k]).sum()
    angular, linear = terms[k:r].sum(), terms[:k].sum()
    is_linear = np.array([unit == "m" for unit in system.units], dtype=bool)
    expected = {
        "canonical momenta": (values.pi[0], H[r:] @ v, terms[r:], is_linear),
        "angular momentum": (values.about[0], angular_momentum, angular, None),
        "spatial angular momentum": (
            values.fixed[0], group.Ad(pose)[k:, k:] @ angular_momentum, angular, None,
        ),
        "centre of mass": (values.c0[0], c, distance, None),
        "momentum": (
            values.v0[0], group.Ad(pose)[:k, :k] @ mu[:k] / system.mass, linear / system.mass, None,
        ),
    }  # fmt: skip
    for what, (value, reference, size, kinds) in expected.items():
        require_agreement(
            f"the initial conditions of '{system.name}'", what, value, reference, size, kinds=kinds
        )
