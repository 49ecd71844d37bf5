"""The mechanical connection: horizontal motions have zero momentum."""

from __future__ import annotations

from functools import partial

import casadi as ca
import numpy as np
import pinocchio as pin

from ...common.arrays import Array
from ...common.machine_code import NativeCode
from ...common.memo import once
from ...kernels.connection.connection_code import ConnectionCode, cached_code
from ...kernels.connection.connection_form import ConnectionForm, form_of
from ...kernels.evaluate import evaluate
from ...kernels.reference_state import length_of, steps_of
from ...kernels.validation import require_agreement
from ...reduction.inertia_split import mass_matrix
from ...reduction.tree.all_joints import joint_values
from ...reduction.tree.body_frames import bodies_of
from ...reduction.tree.momenta import centre_of_mass, locked, momenta
from ...system.system import System, checked_system


def mechanical_form(system: System) -> ConnectionForm:
    """Return the symmetric form H(x) that maps velocities (ξ, ẋ) to the momenta (μ, π)."""
    system = checked_system(system, "Connection.mechanical")
    return form_of(
        system.group, system.shape_names, system.units, f"the momenta of '{system.name}'",
        partial(momenta, system), partial(mass_matrix, system), symmetric=True, momentum=True,
        locked=partial(locked, system), space=system.space,
    )  # fmt: skip


def mechanical_code(system: System) -> ConnectionCode:
    """Return the compiled mechanical connection of a system; it is cached."""
    system = checked_system(system, "Connection.mechanical")
    return once(system, mechanical_code, lambda: ConnectionCode(mechanical_form(system)))


def centres_of_mass(system: System, x: Array) -> Array:
    """Return the centre of mass in the root body's frame at shapes x (N, nx), (N, 3) [m]."""
    shape = ca.SX.sym("x", system.nx)

    def make() -> NativeCode:
        joints = joint_values(system, [shape[k] for k in range(system.nx)])
        com = ca.vertcat(*centre_of_mass(bodies_of(system), joints))
        graph = ca.Function("com", [shape, ca.SX.sym("none")], [ca.densify(com)], {"cse": True})
        code = cached_code(graph.serialize(), "com", lambda: graph)
        _validate_com(system, code)
        return code

    code = once(system, centres_of_mass, make)
    return evaluate(code.address, np.zeros(1), x, 3)


def _validate_com(system: System, code: NativeCode) -> None:
    """Compare with Pinocchio's centre of mass at a random shape.  Raises KernelMismatch."""
    displacement = np.random.default_rng(0).uniform(-2.0, 2.0, system.m)
    displacement *= steps_of(system, length_of(system))[system.r :]
    x = system.space.integrate(system.space.neutral, displacement)
    model, data = system.sorted_model, system.sorted_data
    com = pin.centerOfMass(model, data, system.sorted_q(system.group.identity(), x))
    reach = sum(float(np.linalg.norm(place.translation)) for place in model.jointPlacements)
    slides = [unit == "m" for unit in system.units]
    reach += float(np.abs(displacement[slides]).sum()) + length_of(system)
    require_agreement(
        f"the machine code of '{system.name}'", "the centre of mass",
        evaluate(code.address, np.zeros(1), x[None], 3)[0], data.oMi[1].actInv(com), reach,
    )  # fmt: skip
