"""Springs at ball joints: potentials of the attitude R of the child relative to the parent.

With the rotation vector r = log R and the angle θ = |r|, the laws and their moments in the axes of
the child are

    angle     ½ k θ²             −k r              as in MuJoCo; has a kink at θ = π
    cosine    k (1 − cos θ)      −k sin θ r/θ      smooth everywhere
    vector    ½ rᵀ K r           −J⁻ᵀ K r          J: right Jacobian of the rotation vector
    trace     tr (G (1 − R))     −vee(G R − (G R)ᵀ)

Moments follow from the potentials as expressions of the quaternion.  R is taken relative to the
attitude at rest.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from ..common.argument_kinds import checks_arguments
from ..common.arrays import Array, as_floats, dimensions, read_only
from ..common.errors import InputError
from ..common.names import brief, plain
from ..common.parameter import Parameter
from .force_interface import Force, Symbols, Terms, finite
from .joints import attitude_of

if TYPE_CHECKING:
    import casadi as ca

# Added to the squared length of the vector part of a quaternion, so that its root has a derivative.
_TINY = 1e-300


def relative_attitude(rest: Array, q: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return vector part (3,) and real part of rest⁻¹ ∘ q for unit quaternions."""
    import casadi as ca

    u, w = ca.DM(-rest[:3]), float(rest[3])
    v, s = q[:3], q[3]
    return w * v + s * u + ca.cross(u, v), w * s - ca.dot(u, v)


def rotation_vector(vector: ca.SX, real: ca.SX) -> ca.SX:
    """Return the rotation vector, (3,), with θ ≤ π; it has a derivative at zero."""
    import casadi as ca

    n = ca.sqrt(ca.dot(vector, vector) + _TINY)
    sign = ca.if_else(real < 0.0, -1.0, 1.0)
    rotation: ca.SX = sign * 2.0 * ca.atan2(n, sign * real) / n * vector
    return rotation


@checks_arguments
@dataclass(frozen=True, eq=False)
class BallSpring(Force):
    """A spring at a ball joint.

    Attributes:
        joint: Name of the ball joint.
        stiffness: Stiffness k [N·m/rad]; for the laws "vector" and "trace" also a symmetric
            matrix, (3, 3), in the axes of the child.
        rest: Attitude at rest: a rotation vector, (3,) [rad], or a quaternion (x, y, z, w).
        law: "angle" ½ k θ², "cosine" k (1 − cos θ), "vector" ½ rᵀ K r, or "trace" tr (G (1 − R)).
        polynomial: Coefficients k₂, k₃, … of the law "angle", whose moment is then
            −(k + k₂ θ + k₃ θ² + …) r.
    """

    LAWS: ClassVar[tuple[str, ...]] = ("angle", "cosine", "vector", "trace")

    joint: str
    stiffness: Any
    rest: Any = (0.0, 0.0, 0.0)
    law: str = "angle"
    polynomial: tuple[float | Parameter, ...] = ()

    def __post_init__(self) -> None:
        if self.law not in self.LAWS:
            raise InputError(
                f"law of a {self.label}: expected one of {', '.join(self.LAWS)}, "
                f"got {brief(self.law)}"
            )
        object.__setattr__(self, "rest", attitude_of(self.rest, f"rest of a {self.label}"))
        what = f"stiffness of a {self.label}"
        if isinstance(self.stiffness, Parameter) or dimensions(self.stiffness) == 0:
            object.__setattr__(self, "stiffness", finite(self.stiffness, what))
        else:
            self._check_matrix(what)
        terms = tuple(finite(c, f"polynomial of a {self.label}") for c in self.polynomial)
        if terms and self.law != "angle":
            raise InputError(f"polynomial of a {self.label}: only the law angle has powers")
        object.__setattr__(self, "polynomial", terms)

    def _check_matrix(self, what: str) -> None:
        """Reject a stiffness that is not a symmetric matrix of the law."""
        matrix = as_floats(self.stiffness, what)
        if self.law not in ("vector", "trace") or matrix.shape != (3, 3):
            raise InputError(
                f"{what}: expected a number, or a matrix (3, 3) for the laws vector and trace, got "
                f"{brief(self.stiffness)} for the law {self.law}"
            )
        if not (np.isfinite(matrix).all() and np.array_equal(matrix, matrix.T)):
            raise InputError(f"{what}: expected a finite symmetric matrix, got {brief(matrix)}")
        object.__setattr__(self, "stiffness", read_only(matrix.copy()))

    @property
    def label(self) -> str:
        """Kind of force and its joint."""
        return f"spring {plain(self.joint)}"

    def terms(self, s: Symbols, number: Callable[[Any], Any]) -> Terms:
        """Return the potential.

        Args:
            s: Variables of the system.
            number: Function that replaces a value by a symbol if it may vary.
        Returns:
            Terms with the potential.
        Raises:
            InputError: There is no such ball joint.
        """
        import casadi as ca

        q, _ = s.ball(self.joint, self.label)
        vector, real = relative_attitude(self.rest, q)
        matrix = isinstance(self.stiffness, np.ndarray)
        k = ca.DM(self.stiffness) if matrix else number(self.stiffness)
        if self.law == "cosine":
            return Terms(potential=2.0 * k * ca.dot(vector, vector))
        if self.law == "trace":
            # 1 − R = −2 (w û + û²) with û² = u uᵀ − |u|² 1; G is symmetric, so w û drops out.
            G = k if matrix else k * ca.DM.eye(3)
            square = ca.dot(vector, vector) * ca.trace(G)
            return Terms(potential=2.0 * (square - ca.bilin(ca.SX(G), vector, vector)))
        r = rotation_vector(vector, real)
        if self.law == "vector" and matrix:
            return Terms(potential=0.5 * ca.bilin(ca.SX(k), r, r))
        theta = 2.0 * ca.atan2(ca.sqrt(ca.dot(vector, vector) + _TINY), ca.fabs(real))
        potential = 0.5 * k * theta * theta
        for n, coefficient in enumerate(self.polynomial, start=3):
            potential += number(coefficient) / n * theta**n
        return Terms(potential=potential)
