"""The state that forces depend on, in the frame of the centre of mass."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ..common.arrays import Array
from ..forces.force_values import BaseInSpace, ForceInputs


@dataclass(frozen=True)
class Sample:
    """The state that forces depend on, in the frame of the centre of mass.

    At T times, all fields have a leading axis of length T.

    Attributes:
        x: Shape, (nx,) [rad | m | 1].
        xdot: Shape rate, (m,) [rad/s | m/s].
        xi: Body twist relative to the centre of mass, (r,) [m/s | rad/s].
        mu: Body momentum about the centre of mass, (r,) [N·s | N·m·s]; its linear part is zero.
        weight: Gravity force m g in the body frame if it rotates a pivoted base, else zero, (3,)
            [N].
        base: State of the base in the fixed frame, None if the scene leaves it out.
    """

    x: Array
    xdot: Array
    xi: Array
    mu: Array
    weight: Array
    base: BaseInSpace | None = None

    def force_inputs(self, t: float | Array, numbers: Array) -> ForceInputs:
        """Return the arguments of a ForceModel.

        Args:
            t: Time, or times (T,) [s].
            numbers: Force parameters, (p,) or (T, p).
        Returns:
            The arguments.
        """
        return ForceInputs(t, self.x, self.xdot, self.xi, self.mu, numbers, self.base)


def map_samples(function: Callable[..., Array], samples: Sequence[Sample]) -> Sample:
    """Return the sample whose fields are a function of the lists of fields of several samples."""
    fields = [(s.x, s.xdot, s.xi, s.mu, s.weight) for s in samples]
    base, bases = None, [s.base for s in samples if s.base is not None]
    if bases:
        in_space = [(b.pose, b.xi, b.mu, b.J) for b in bases]
        base = BaseInSpace(*map(function, zip(*in_space, strict=True)))
    x, xdot, xi, mu, weight = map(function, zip(*fields, strict=True))
    return Sample(x, xdot, xi, mu, weight, base)
