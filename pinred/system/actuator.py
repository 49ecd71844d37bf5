"""Actuators of a robot file whose forces are linear in their control and in the joint's state."""

from __future__ import annotations

from dataclasses import dataclass

from ..common.argument_kinds import checks_arguments


@checks_arguments
@dataclass(frozen=True)
class Actuator:
    """An actuator at a joint, as in MuJoCo.

    Its length is l = gear·x, with rate v.  With the control u, clamped to its limits, the force is

        f = (g₀ + g₁ l + g₂ v) u + b₀ + b₁ l + b₂ v,

    clamped to its limits.  The torque at the joint is gear·f.  At a ball, x is the rotation vector
    of the child relative to the parent, and l̇ is gear·ω.

    Attributes:
        name: Name of the actuator.
        joint: Name of its joint.
        kind: "motor" (f = g₀ u), "position" (f = g₀ u + b₁ l + b₂ v with b₁ = −g₀), "velocity"
            (f = g₀ (u − v)), "damper" (f = g₂ v u), or "general".
        gear: Factors of the force, (1,), or about the axes of a ball, (3,).
        gain: Gain (g₀, g₁, g₂).
        bias: Bias (b₀, b₁, b₂).
        control_limits: Smallest and largest control, or None.
        force_limits: Smallest and largest force f, or None.
        torque_limits: Smallest and largest sum of the torques of all actuators at the joint
            [N·m | N], or None.
        in_parent: Whether the gear of a ball has the axes of the parent instead of the child.
        on_base: Whether the joint moves the base.
    """

    name: str
    joint: str
    gear: tuple[float, ...] = (1.0,)
    gain: tuple[float, float, float] = (1.0, 0.0, 0.0)
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    control_limits: tuple[float, float] | None = None
    force_limits: tuple[float, float] | None = None
    torque_limits: tuple[float, float] | None = None
    in_parent: bool = False
    on_base: bool = False

    @property
    def kind(self) -> str:
        """The element of MJCF that has this gain and bias."""
        (g0, g1, g2), (b0, b1, b2) = self.gain, self.bias
        if (g1, g2, b0) == (0.0, 0.0, 0.0):
            if b1 == b2 == 0.0:
                return "motor"
            if b1 == -g0 and b2 <= 0.0:
                return "position"
            if b1 == 0.0 and b2 == -g0:
                return "velocity"
        elif g0 == g1 == 0.0 and self.bias == (0.0, 0.0, 0.0):
            return "damper"
        return "general"

    def __str__(self) -> str:
        gear = " ".join(f"{value:g}" for value in self.gear)
        limits = [
            f"{what} from {limits[0]:g} to {limits[1]:g}"
            for what, limits in (
                ("control", self.control_limits),
                ("force", self.force_limits),
                ("torque", self.torque_limits),
            )
            if limits is not None
        ]
        return ", ".join([f"{self.name}: {self.kind} at {self.joint}, gear {gear}", *limits])
