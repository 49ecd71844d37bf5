"""The double spherical pendulum of two point masses on massless rods, and its Lagrangian.

Each rod is attached by a universal joint with a massless ring. The coordinates are
(azimuth, tilt1, swing2, tilt2): rod 1 is Rz(azimuth) Ry(tilt1) (−e_z), rod 2 is
Rz(azimuth) Ry(tilt1) Rx(swing2) Ry(tilt2) (−e_z). Source of the example: J. E. Marsden and
J. Scheurle, "Lagrangian reduction and the double spherical pendulum", Z. angew. Math. Phys. 44
(1993).
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from pinred.common.arrays import Array

MASSES, LENGTHS, GRAVITY = (1.5, 0.7), (1.0, 0.6), 9.81  # kg, m, m/s²


def _link(name: str, mass: float = 0.0, length: float = 0.0) -> str:
    inertial = (
        f'<inertial><origin xyz="0 0 {-length}"/><mass value="{mass}"/>'
        '<inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial>'
    )
    return f'<link name="{name}">{inertial if mass else ""}</link>'


def _joint(name: str, parent: str, child: str, axis: str, down: float = 0.0) -> str:
    return (
        f'<joint name="{name}" type="continuous"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0 0 {-down}"/><axis xyz="{axis}"/></joint>'
    )


def urdf(masses: tuple[float, float], lengths: tuple[float, float]) -> str:
    """Return the URDF of the pendulum.  masses: [kg].  lengths: of the rods [m]."""
    return "".join(
        (
            '<robot name="point_pendulum">',
            *(_link("world"), _link("ring1"), _link("rod1", masses[0], lengths[0])),
            *(_link("ring2"), _link("rod2", masses[1], lengths[1])),
            _joint("azimuth", "world", "ring1", "0 0 1"),
            _joint("tilt1", "ring1", "rod1", "0 1 0"),
            _joint("swing2", "rod1", "ring2", "1 0 0", lengths[0]),
            _joint("tilt2", "ring2", "rod2", "0 1 0"),
            "</robot>",
        )
    )


URDF = urdf(MASSES, LENGTHS)


class Lagrangian:
    """Mass matrix and accelerations, derived from the positions of the two point masses."""

    def __init__(self) -> None:
        """Differentiate the Lagrangian ½ Σ m |ṗ|² − Σ m g z."""
        y, v = ca.SX.sym("y", 4), ca.SX.sym("v", 4)
        c, s = ca.cos(y), ca.sin(y)
        # End of rod 1, and rod 2 in the axes of rod 1, without matrix products.
        first = LENGTHS[0] * ca.vertcat(-c[0] * s[1], -s[0] * s[1], -c[1])
        inner = LENGTHS[1] * ca.vertcat(-s[3], s[2] * c[3], -c[2] * c[3])
        across = c[1] * inner[0] + s[1] * inner[2]
        second = first + ca.vertcat(
            c[0] * across - s[0] * inner[1],
            s[0] * across + c[0] * inner[1],
            -s[1] * inner[0] + c[1] * inner[2],
        )
        kinetic, potential = ca.SX(0), ca.SX(0)
        for mass, position in zip(MASSES, (first, second), strict=True):
            speed = ca.jacobian(position, y) @ v
            kinetic += 0.5 * mass * ca.dot(speed, speed)
            potential += mass * GRAVITY * position[2]
        M = ca.hessian(kinetic, v)[0]
        momentum = ca.gradient(kinetic, v)
        force = ca.gradient(kinetic - potential, y) - ca.jacobian(momentum, y) @ v
        self._function = ca.Function("lagrangian", [y, v], [M, force, kinetic + potential])

    def __call__(self, y: Array, v: Array) -> tuple[Array, Array, float]:
        """Return mass matrix (4, 4), accelerations (4,) and energy at angles and rates (4,)."""
        M, force, energy = (np.array(value) for value in self._function(y, v))
        return M, np.asarray(np.linalg.solve(M, force)[:, 0], dtype=float), float(energy[0, 0])
