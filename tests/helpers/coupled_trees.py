"""Random trees whose joints follow others, and what the tests know of them on their own.

From the couplings alone, by solving their equations and not by following them: x = G y + b, and
the accelerations with multipliers.
"""

from __future__ import annotations

from dataclasses import dataclass

import aba
import numpy as np
import pinocchio as pin
from forced_trees import GRAVITY
from hypothesis import strategies as st
from strategies import groups, seeds
from trees import random_model

import pinred
from pinred.common.arrays import Array
from pinred.system.contents import Contents, Coupling


@dataclass(frozen=True)
class CoupledCase:
    """A system with couplings, and its map from the shape to all joints.

    G: (M, m).  b: (M,).
    """

    system: pinred.System
    G: Array
    b: Array
    rng: np.random.Generator

    @property
    def whole(self) -> Array:
        """The map (nv, n) from (ξ, ẏ) to the model's velocities."""
        r = self.system.r
        out = np.zeros((self.system.model.nv, self.system.n))
        out[:r, :r], out[r:, r:] = np.eye(r), self.G
        return out

    def mass_matrix(self, x: Array) -> Array:
        """GᵀHG by CRBA."""
        q = self.system.model_q(self.system.group.identity(), x)
        upper = np.triu(pin.crba(self.system.model, self.system.model.createData(), q))
        return np.asarray(self.whole.T @ (upper + np.triu(upper, 1).T) @ self.whole)


def tied(system: pinred.System) -> tuple[Array, Array]:
    """G and b of a system, from the equations of its couplings."""
    names = list(system.model.names)[2:]
    rows, right = np.eye(len(names)), np.zeros(len(names))
    own = np.zeros((len(names), system.m))
    for each in system.couplings:
        k = names.index(each.follower)
        rows[k, names.index(each.leader)] -= each.ratio
        right[k] = each.offset
    for i, name in enumerate(system.shape_names):
        own[names.index(name), i] = 1.0
    return np.asarray(np.linalg.solve(rows, own)), np.asarray(np.linalg.solve(rows, right))


def couple(model: pin.Model, rng: np.random.Generator, most: int) -> tuple[Coupling, ...]:
    """Random couplings of a model's shape joints: chains, several groups, any signs, zero."""
    names = [str(name) for name in rng.permutation(list(model.names)[2:])]
    count = int(rng.integers(1, min(most, len(names) - 1) + 1))
    out = []
    for k in sorted(rng.choice(np.arange(1, len(names)), count, replace=False).tolist()):
        ratio = float(rng.choice([1.0, -1.0, 0.0, 2.0, rng.normal(), rng.normal()]))
        offset = float(rng.choice([0.0, rng.normal()]))
        out.append(Coupling(names[k], names[int(rng.integers(k))], ratio, offset))
    return tuple(out[int(i)] for i in rng.permutation(len(out)))


def make_case(group: str, joints: int, seed: int, *, heavy: bool = False) -> CoupledCase:
    """The case of a seed.  heavy: in gravity, where the group allows any."""
    rng = np.random.default_rng(seed)
    model = random_model(group, joints, seed)
    if heavy:
        model.gravity.linear = np.array(GRAVITY.get(group, (0.0, 0.0, 0.0)))
    contents = Contents(couplings=couple(model, rng, 4))
    system = pinred.System(model, model.name, contents=contents)
    G, b = tied(system)
    return CoupledCase(system, G, b, rng)


def coupled_cases(least: int = 2, most: int = 8) -> st.SearchStrategy[CoupledCase]:
    """Random trees of `least` to `most` joints on any group, with couplings."""
    return st.builds(make_case, groups, st.integers(least, most), seeds)


def multipliers(system: pinred.System) -> aba.Torques:
    """The forces Jᵀλ that keep followers on their leaders, by Pinocchio's ABA alone."""
    model, r = system.model, system.r
    names, data = list(model.names)[2:], model.createData()
    still = model.copy()
    still.gravity.setZero()
    J = np.zeros((len(system.couplings), model.nv))
    for row, each in zip(J, system.couplings, strict=True):
        row[r + names.index(each.follower)] = 1.0
        row[r + names.index(each.leader)] -= each.ratio

    def tau(_t: float, q: Array, v: Array) -> Array:
        rest = np.zeros(model.nv)
        pushed = np.array([pin.aba(still, data, q, rest, row).copy() for row in J])
        free = pin.aba(model, data, q, v, rest)
        return np.asarray(-J.T @ np.linalg.solve(J @ pushed.T, J @ free))

    return tau
