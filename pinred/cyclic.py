"""Cyclic joints: those on whose angle neither the inertia nor the potential depends.

Their momentum is constant and their angle a quadrature (Routh): reaction wheels, rotors.
"""

from __future__ import annotations

import numpy as np

from .errors import SymmetryError
from .reduction import Reduction

_SAMPLES = 3  # random shapes at which a dependence would show
_NO_DEPENDENCE = 1e-12  # of the mass matrix


def cyclic_joints(red: Reduction) -> tuple[int, ...]:
    """Return the indices of the joints that leave mass matrix and potential unchanged.

    Where gravity breaks the symmetry there is no potential on the shape, and none is cyclic.
    """
    r, m = red.system.r, red.system.m
    rng = np.random.default_rng(0)
    depends = np.zeros(m, dtype=bool)
    for _ in range(_SAMPLES if m else 0):
        at = red.at(rng.uniform(-3.0, 3.0, m))
        small = _NO_DEPENDENCE * np.linalg.norm(at.mass_matrix)
        for derivative in (at.dI, at.dM, at.locked_inertia @ at.dA.reshape(r, -1)):
            depends |= (np.abs(derivative).reshape(-1, m) > small).any(axis=0)
        try:
            depends |= np.abs(red.potential_gradient(at.x)) > small
        except SymmetryError:
            depends[:] = True
    return tuple(np.flatnonzero(~depends).tolist())
