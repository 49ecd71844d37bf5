"""Cyclic joints: those on whose angle neither the inertia nor the potential depends.

Their momentum is constant and their angle a quadrature (Routh): reaction wheels, rotors.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import pinocchio as pin

from ..common.errors import SymmetryError
from ..system.system import System
from .potential import pivot_weight
from .reduction import Reduction

_SAMPLES = 3  # random shapes at which a dependence would show
_NO_DEPENDENCE = 1e-12  # of the mass matrix


def cyclic_joints(red: Reduction, touched: Collection[int] = ()) -> tuple[int, ...]:
    """Return the indices of the joints that leave mass matrix and potential unchanged.

    touched: joints that something else acts on, or whose position something depends on.  Where
    gravity turns a pivoted base, its centre of mass must not move with the joint; where gravity
    breaks the symmetry otherwise, there is no potential on the shape, and no joint is cyclic.
    """
    system = red.system
    r, m = system.r, system.m
    rng = np.random.default_rng(0)
    depends = np.zeros(m, dtype=bool)
    depends[list(touched)] = True
    data = system.model.createData()
    heavy = pivot_weight(system).any()
    for _ in range(_SAMPLES if m else 0):
        at = red.at(rng.uniform(-3.0, 3.0, m))
        small = _NO_DEPENDENCE * np.linalg.norm(at.mass_matrix)
        for derivative in (at.dI, at.dM, at.locked_inertia @ at.dA.reshape(r, -1)):
            depends |= (np.abs(derivative).reshape(-1, m) > small).any(axis=0)
        if heavy:
            q = system.model_q(system.group.identity(), at.x)
            slope = system.mass * pin.jacobianCenterOfMass(system.model, data, q)[:, r:]
            depends |= (np.abs(slope) > small).any(axis=0)
            continue
        try:
            depends |= np.abs(red.potential_gradient(at.x)) > small
        except SymmetryError:
            depends[:] = True
    return tuple(np.flatnonzero(~depends).tolist())


def cyclic_of(system: System, touched: frozenset[int]) -> tuple[int, ...]:
    """Return the cyclic joints of a system that are not touched; found once."""
    return system.workspace((cyclic_of, touched), lambda: cyclic_joints(Reduction(system), touched))
