"""The base as it follows the shape: which parts are integrated, which known in closed form.

Translations are not integrated.  In the frame of the centre of mass the linear momentum is
zero; the centre of mass itself moves on c0 + v0 t + ½ g t², and the base is where that puts
it, p = c − R c_b(x).  Of the rotation, the attitude is integrated if it is asked for; the
angular momentum is not: about a single axis (SO(2), SE(2), ℝ × SE(2)) it is a constant, in SO(3)
and SE(3) it turns with the body, μ = Rᵀ J.

Forces on the base make more parts move.  A wrench (F, N) at the base's origin, in its frame,
or the weight of a pivoted body changes the angular momentum μ about the centre of mass (in
SO(3), about the pivot), which is then integrated,

    μ̇ = μ × ω + N − c × F + m|g| c × Γ

and a wrench pushes the centre of mass off its path: δċ = δP/m, δṖ = R F.  Where the base is
not wanted, the 3 numbers μ stand for the 4 of the attitude, and the direction of gravity in
the body, Γ̇ = Γ × ω, for the attitude under the weight.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..common.arrays import Array
from ..lie.group import Group
from ..lie.rotations import apply, rotation
from ..system.system import System
from .potential import falling, translations


@dataclass(frozen=True)
class BaseParts:
    """Counts of the base's numbers: those that are integrated, in this order, and constants.

    attitude: its angle or quaternion.  down: the direction Γ of gravity in the body's frame.
    momentum: angular momentum in the body's frame, about the centre of mass.  push: how far
    a wrench has driven the centre of mass off its path, and the momentum it has given it.
    spin: the angular momentum where it is a constant, in the fixed frame; not integrated.
    """

    attitude: int = 0
    down: int = 0
    momentum: int = 0
    push: int = 0
    spin: int = 0

    @property
    def size(self) -> int:
        """The number of entries that are integrated."""
        return self.attitude + self.down + self.momentum + self.push

    def split(self, b: Array) -> tuple[Array, Array, Array, Array]:
        """Return attitude, down, momentum and push of b (..., size)."""
        i = self.attitude
        j = i + self.down
        k = j + self.momentum
        return b[..., :i], b[..., i:j], b[..., j:k], b[..., k:]


def base_parts(
    group: Group, *, wanted: bool, heavy: bool, wrench: bool, zero_momentum: bool
) -> BaseParts:
    """Return the parts of the base that are integrated, for a group.

    wanted: whether the base is asked for.  heavy: whether gravity turns it.  wrench:
    whether one acts on it.  zero_momentum: whether its angular momentum is exactly zero.
    """
    turns = group.turns
    changing = turns > 0 and (heavy or wrench)
    free = turns == 3 and not wanted and not zero_momentum
    momentum = turns if changing or free else 0
    return BaseParts(
        attitude=group.size - group.linear if wanted else 0,
        down=3 if heavy and not wanted else 0,
        momentum=momentum,
        push=2 * group.linear if wrench and wanted else 0,
        spin=0 if momentum or zero_momentum else turns,
    )


@dataclass(frozen=True)
class Root:
    """The facts about a system's base that hold in every state.

    axes: (3, k) directions of its translations.  g: (k,) its acceleration by gravity along them
    [m/s²].  origin: (3,) origin of the root joint's fixed frame, in that frame.
    """

    axes: Array
    g: Array
    origin: Array


def root_of(system: System) -> Root:
    """Return the root of a system, found once."""
    return system.workspace(Root, lambda: _find_root(system))


def _find_root(system: System) -> Root:
    placement = system.model.jointPlacements[1]
    origin = placement.rotation.T @ placement.translation
    return Root(translations(system), falling(system), origin)


def into_body(q: Array, v: Array) -> Array:
    """Return Rᵀ v, (N, 3), for unit quaternions (N, 4) and a vector of the fixed frame."""
    return np.asarray(apply(np.swapaxes(rotation(q), -1, -2), v))


def quaternion_rate(q: Array, omega: Array) -> Array:
    """Return ½ q ω, (4,), by scalars, which are faster here; it runs at every step."""
    x, y, z, w = q.tolist()
    a, b, c = omega.tolist()
    return 0.5 * np.array(
        [
            w * a + y * c - z * b,
            w * b + z * a - x * c,
            w * c + x * b - y * a,
            -x * a - y * b - z * c,
        ]
    )
