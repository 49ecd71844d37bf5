"""Variables of the base: those that are integrated, and those with a closed form.

Translations are not integrated.  In the frame of the centre of mass the linear momentum is
zero.  The centre of mass follows c0 + v0 t + ½ g t², and the base is at p = c − R c_b(x).  The
attitude is integrated if it is requested.  The angular momentum is not integrated: about a single
axis (SO(2), SE(2), ℝ × SE(2)) it is constant, and in SO(3) and SE(3) it rotates with the body,
μ = Rᵀ J.

Forces on the base require more variables.  A wrench (F, N) at the base's origin, in its frame, or
the weight of a pivoted body changes the angular momentum μ about the centre of mass (in SO(3),
about the pivot), which is then integrated,

    μ̇ = μ × ω + N − c × F + m|g| c × Γ.

A wrench also pushes the centre of mass off its path: δċ = δP/m, δṖ = R F.  If the base is not
requested, the 3 entries of μ replace the 4 entries of the attitude, and the direction of gravity in
the body, Γ̇ = Γ × ω, replaces the attitude under the weight.
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
    """Sizes of the base variables: first the integrated variables, in order, then constants.

    Attributes:
        attitude: Number of attitude coordinates, an angle or a quaternion.
        down: Direction Γ of gravity in the body's frame.
        momentum: Angular momentum in the body's frame, about the centre of mass.
        push: Deviation of the centre of mass from its path under a wrench, and the momentum that
            the wrench has added.
        spin: Angular momentum in the fixed frame where it is constant; not integrated.
    """

    attitude: int = 0
    down: int = 0
    momentum: int = 0
    push: int = 0
    spin: int = 0

    @property
    def size(self) -> int:
        """Number of integrated entries."""
        return self.attitude + self.down + self.momentum + self.push

    def split(self, b: Array) -> tuple[Array, Array, Array, Array]:
        """Return attitude, down, momentum and push from b (..., size)."""
        i = self.attitude
        j = i + self.down
        k = j + self.momentum
        return b[..., :i], b[..., i:j], b[..., j:k], b[..., k:]


def base_parts(
    group: Group, *, wanted: bool, heavy: bool, wrench: bool, zero_momentum: bool
) -> BaseParts:
    """Return the sizes of the base variables that a scene needs.

    Args:
        group: Symmetry group.
        wanted: Whether the pose of the base is requested.
        heavy: Whether gravity rotates the base about a pivot.
        wrench: Whether a wrench acts on the base.
        zero_momentum: Whether the angular momentum is exactly zero.
    Returns:
        Sizes of the integrated and of the constant variables.
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
    """Constants of a system's base.

    Attributes:
        axes: Directions of the base's translations, (3, k), in the root joint's fixed frame.
        g: Acceleration of the base by gravity along `axes`, (k,) [m/s²].
        origin: Position of the root joint's fixed frame in the world, in its own axes, (3,) [m].
    """

    axes: Array
    g: Array
    origin: Array


def root_of(system: System) -> Root:
    """Return the constants of a system's base; the result is cached."""

    def make() -> Root:
        placement = system.model.jointPlacements[1]
        origin = placement.rotation.T @ placement.translation
        return Root(translations(system), falling(system), origin)

    return system.workspace(Root, make)


def into_body(q: Array, v: Array) -> Array:
    """Return Rᵀ v, (N, 3), for unit quaternions q (N, 4) and a vector v of the fixed frame."""
    return np.asarray(apply(np.swapaxes(rotation(q), -1, -2), v))


def quaternion_rate(q: Array, omega: Array) -> Array:
    """Return q̇ = ½ q ω, (4,); scalar arithmetic, because every step calls this function."""
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
