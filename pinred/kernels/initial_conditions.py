"""The start of a flow from initial states, as machine code: one kernel for a robot.

From pose, shape, its rate, and body twist or momentum come the canonical momenta π in the
frame of the centre of mass, the angular momentum about it in the body's frame and in the
fixed one, and where the centre of mass begins and how fast it moves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import casadi as ca
import numpy as np
import pinocchio as pin

from ..common.arrays import Array
from ..common.memo import once
from ..reduction.base_parts import BaseParts
from ..reduction.inertia_split import mass_matrix_at
from ..reduction.potential import translations
from ..reduction.tree.all_joints import joint_values
from ..reduction.tree.articulated_sweep import sweep
from ..reduction.tree.body_frames import bodies_of
from ..reduction.tree.free_bodies import NOTHING, Freed, free_numbers, total_mass, with_free
from ..reduction.tree.momenta import centre_of_mass, momenta
from ..reduction.tree.scalars import Scalar
from ..system.other_inertias import nominal
from ..system.system import System
from .base_graph import BaseGraph
from .evaluate import evaluate
from .fingerprint import model_bytes
from .machine.native import NativeCode, compile_object, load_object
from .object_cache import ObjectCache, cache_key
from .reference_state import perturb_parameters
from .validation import explain_ill_scaling, require_agreement

TwistOrMomentum = Literal["xi", "mu"]
_NAME = "start"


@dataclass(frozen=True)
class InitialConditions:
    """The starts of flows from N initial states.

    pi: (N, m) canonical momenta.  about: (N, a) angular momenta about the centre of mass, in
    the body's frame, and fixed: (N, a) in the fixed frame.  c0, v0: (N, k) centre of mass
    and its velocity in the root joint's fixed frame.
    """

    pi: Array
    about: Array
    fixed: Array
    c0: Array
    v0: Array


@dataclass(frozen=True)
class InitialConditionsKernel:
    """Machine code from initial states to the starts of flows.

    system: whose numbers it takes where none are given.  freed: which of them are inputs.
    """

    system: System
    freed: Freed
    code: NativeCode

    def __call__(
        self, pose: Array, x: Array, xdot: Array, motion: Array, numbers: Array | None = None
    ) -> InitialConditions:
        """Return the starts for poses (N, size), x and ẋ (N, m), body twists or momenta (N, r).

        numbers: of freed bodies, (freed.size,) of all, or (N, freed.size).
        """
        m, r, k = self.system.m, self.system.r, self.system.group.linear
        rows = np.concatenate([pose, x, xdot, motion], axis=1)
        if numbers is None:
            numbers = free_numbers(self.system, self.freed) if self.freed else np.zeros(1)
        address, size = self.code.address, m + 2 * r
        if numbers.ndim == 1:
            out = evaluate(address, numbers, rows, size)
        else:
            each = zip(numbers, rows[:, None], strict=True)
            out = np.concatenate([evaluate(address, own, row, size) for own, row in each])
        about, fixed, c0, v0 = m, m + r - k, m + 2 * (r - k), m + 2 * (r - k) + k
        return InitialConditions(
            pi=out[:, :about],
            about=out[:, about:fixed],
            fixed=out[:, fixed:c0],
            c0=out[:, c0:v0],
            v0=out[:, v0:],
        )


def initial_conditions_kernel(
    system: System, given: TwistOrMomentum, freed: Freed = NOTHING
) -> InitialConditionsKernel:
    """Return the kernel for initial states with a body twist ("xi") or a body momentum ("mu").

    freed: the numbers of bodies that are inputs.

    Raises KernelMismatch if it disagrees with Pinocchio, ModelError if the system is ill-scaled.
    """

    def make() -> InitialConditionsKernel:
        cache = ObjectCache()
        key = cache_key(model_bytes(system, freed), f"start from {given}{freed.steps or ''}")
        code = cache.get(key)
        if code is None:
            code = compile_object(initial_conditions_graph(system, given, freed), _NAME)
            cache.put(key, code)
        kernel = InitialConditionsKernel(system, freed, load_object(code, _NAME))
        with explain_ill_scaling(system):
            _judge(kernel, given)
            if freed:  # with other numbers, too
                _judge(replace(kernel, system=perturb_parameters(system, freed)), given)
        return kernel

    found = once(
        nominal(system) if freed else system, (InitialConditionsKernel, given, freed), make
    )
    return replace(found, system=system) if freed else found


def initial_conditions_graph(
    system: System, given: TwistOrMomentum, freed: Freed = NOTHING
) -> ca.Function:
    """Return the start as a Function of (pose, x, ẋ, ξ or μ) and of the numbers of freed bodies."""
    numbers = ca.SX.sym("numbers", freed.size)
    bodies = with_free(bodies_of(system), freed, ca.vertsplit(numbers) if freed else [])
    mass = total_mass(bodies) if freed.inertias else system.mass
    group, m, r = system.group, system.m, system.r
    k = group.linear
    pose, x, xdot = ca.SX.sym("pose", group.size), ca.SX.sym("x", m), ca.SX.sym("xdot", m)
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
        found = sweep(
            bodies, joints, [0.0] * m, [0.0] * k + about, group.axes, armature,
            dict(enumerate(ca.vertsplit(xdot))) if m else {}, coupled=system.coupled,
        )  # fmt: skip
        pi = found.pi
    fixed, moved, velocity = (
        base.turned_angular(about), base.turned(base.along(com)), base.turned(velocity)
    )  # fmt: skip
    c0 = [a + b for a, b in zip(ca.vertsplit(pose)[:k], moved, strict=True)]
    out = ca.vertcat(ca.SX(0, 1), *pi, *about, *fixed, *c0, *velocity)
    attitude = ca.vertsplit(pose)[k:]
    if attitude:
        out = ca.substitute(out, ca.vertcat(*base.attitude), ca.vertcat(*attitude))
    inputs = ca.vertcat(pose, x, xdot, motion)
    return ca.Function(
        _NAME, [inputs, numbers if freed else ca.SX.sym("none")], [ca.densify(out)], {"cse": True}
    )


def _judge(kernel: InitialConditionsKernel, given: TwistOrMomentum) -> None:
    """Compare a kernel with Pinocchio's mass matrix at a random state."""
    system, rng = kernel.system, np.random.default_rng(0)
    group, r = system.group, system.r
    k = group.linear
    pose, x = group.exp(rng.uniform(-1.0, 1.0, r)), rng.uniform(-2.0, 2.0, system.m)
    xi, xdot = rng.normal(size=r), rng.normal(size=system.m)
    data = system.data
    H = mass_matrix_at(system, system.model, data, group.identity(), x)
    mu = H[:r] @ np.concatenate([xi, xdot])
    motion = xi if given == "xi" else mu
    found = kernel(*(row[None] for row in (pose, x, xdot, motion)))
    relative = xi.copy()
    relative[:k] -= mu[:k] / system.mass
    v = np.concatenate([relative, xdot])
    q = system.model_q(pose, x)
    pin.centerOfMass(system.model, data, q, system.model_v(xi, xdot))
    root = system.model.jointPlacements[1]
    c = translations(system).T @ root.actInv(pin.centerOfMass(system.model, data, q))
    about = H[k:r] @ v
    # If a momentum is given, what it is a sum of has moved the twist that it is made into.
    whole = np.concatenate([xi, xdot])
    terms = np.abs(H) @ np.abs(whole)
    moved = np.abs(whole)
    moved[:r] += np.abs(np.linalg.inv(H[:r, :r])) @ np.full(r, terms[:r].max())
    terms = np.abs(H) @ moved
    far, turning, push = np.abs(c).sum() + np.abs(pose[:k]).sum(), terms[k:r].sum(), terms[:k].sum()
    expected = {
        "canonical momenta": (found.pi[0], H[r:] @ v, terms[r:]),
        "angular momentum": (found.about[0], about, turning),
        "spatial angular momentum": (found.fixed[0], group.Ad(pose)[k:, k:] @ about, turning),
        "centre of mass": (found.c0[0], c, far),
        "momentum": (
            found.v0[0], group.Ad(pose)[:k, :k] @ mu[:k] / system.mass, push / system.mass,
        ),
    }  # fmt: skip
    for what, (value, true, size) in expected.items():
        require_agreement(f"the start kernel of '{system.name}'", what, value, true, size)
