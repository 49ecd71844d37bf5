"""Random trees with coupled joints, and their coupling maps by independent formulas.

The map x = G y + b is computed by solving the linear system of the coupling equations. The
accelerations are computed with Lagrange multipliers.
"""

from __future__ import annotations

from dataclasses import dataclass
from zlib import crc32

import aba
import numpy as np
import pinocchio as pin
from forced_trees import GRAVITY
from hypothesis import strategies as st
from strategies import groups, seeds
from trees import random_model

import pinred
from pinred.common.arrays import Array
from pinred.system.robot_file_contents import Contents, Coupling


@dataclass(frozen=True)
class CoupledCase:
    """A system with couplings, and the map x = G y + b from the shape to all joints.

    Attributes:
        system: The coupled system.
        G: Matrix of the map, (M, m).
        b: Offset of the map, (M,) [rad | m].
        rng: Random generator for states of the case.
    """

    system: pinred.System
    G: Array
    b: Array
    rng: np.random.Generator

    @property
    def whole(self) -> Array:
        """The map from (ξ, ẏ) to the velocities of the model, (nv, n)."""
        r = self.system.r
        velocity_map = np.zeros((self.system.model.nv, self.system.n))
        velocity_map[:r, :r], velocity_map[r:, r:] = np.eye(r), self.G
        return velocity_map

    def mass_matrix(self, x: Array) -> Array:
        """Return GᵀHG with H by CRBA, (n, n)."""
        q = self.system.q(self.system.group.identity(), x)
        upper = np.triu(pin.crba(self.system.model, self.system.model.createData(), q))
        return np.asarray(self.whole.T @ (upper + np.triu(upper, 1).T) @ self.whole)


def coupling_map(system: pinred.System) -> tuple[Array, Array]:
    """Return G and b of a system by solving the equations of its couplings."""
    names = list(system.model.names)[2:]
    equations, constants = np.eye(len(names)), np.zeros(len(names))
    free_columns = np.zeros((len(names), system.m))
    for coupling in system.couplings:
        k = names.index(coupling.follower)
        for leader, ratio in coupling.ratios.items():
            equations[k, names.index(leader)] -= ratio
        constants[k] = coupling.offset
    for i, name in enumerate(system.shape_names):
        free_columns[names.index(name), i] = 1.0
    return np.asarray(np.linalg.solve(equations, free_columns)), np.asarray(
        np.linalg.solve(equations, constants)
    )


def couple(model: pin.Model, rng: np.random.Generator, most: int) -> tuple[Coupling, ...]:
    """Return random couplings of a model: chains, several groups or leaders, ratios of 0."""
    names = [str(name) for name in rng.permutation(list(model.names)[2:])]
    count = int(rng.integers(1, min(most, len(names) - 1) + 1))
    couplings = []
    more = np.random.default_rng(crc32("".join(names).encode()))  # leaves `rng` as it is
    for k in sorted(rng.choice(np.arange(1, len(names)), count, replace=False).tolist()):
        ratio = float(rng.choice([1.0, -1.0, 0.0, 2.0, rng.normal(), rng.normal()]))
        offset = float(rng.choice([0.0, rng.normal()]))
        ratios = {names[int(rng.integers(k))]: ratio}
        if k > 1 and more.random() < 0.5:
            ratios.setdefault(names[int(more.integers(k))], float(more.normal()))
        couplings.append(Coupling(names[k], ratios, offset))
    return tuple(couplings[int(i)] for i in rng.permutation(len(couplings)))


def make_case(group: str, joints: int, seed: int, *, heavy: bool = False) -> CoupledCase:
    """Return the random case of a seed.

    Args:
        group: Name of the symmetry group.
        joints: Number of shape joints of the tree.
        seed: Seed of tree and couplings.
        heavy: Add gravity, if the group allows it.
    """
    rng = np.random.default_rng(seed)
    model = random_model(group, joints, seed)
    if heavy:
        model.gravity.linear = np.array(GRAVITY.get(group, (0.0, 0.0, 0.0)))
    contents = Contents(couplings=couple(model, rng, 4))
    system = pinred.System(model, model.name, contents=contents)
    G, b = coupling_map(system)
    return CoupledCase(system, G, b, rng)


def coupled_cases(least: int = 2, most: int = 8) -> st.SearchStrategy[CoupledCase]:
    """Return a strategy for coupled trees of `least` to `most` joints on any group."""
    return st.builds(make_case, groups, st.integers(least, most), seeds)


def multipliers(system: pinred.System) -> aba.Torques:
    """Return the constraint forces Jᵀλ of the couplings as torques, by ABA alone."""
    model, r = system.model, system.r
    names, data = list(model.names)[2:], model.createData()
    weightless = model.copy()
    weightless.gravity.setZero()
    J = np.zeros((len(system.couplings), model.nv))
    for row, coupling in zip(J, system.couplings, strict=True):
        row[r + names.index(coupling.follower)] = 1.0
        for leader, ratio in coupling.ratios.items():
            row[r + names.index(leader)] -= ratio

    def tau(_t: float, q: Array, v: Array) -> Array:
        zero = np.zeros(model.nv)
        unit_accelerations = np.array([pin.aba(weightless, data, q, zero, row).copy() for row in J])
        free = pin.aba(model, data, q, v, zero)
        return np.asarray(-J.T @ np.linalg.solve(J @ unit_accelerations.T, J @ free))

    return tau
