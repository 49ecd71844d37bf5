"""RelativeEquilibrium: a steady motion, its stability, and scenes that start in this motion.

Census: the count of equilibria that a search found, and evidence of missing equilibria.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import overload

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays
from ...common.errors import InputError
from ...lie.rotations import quaternion_exp
from ...reduction.pointwise_reduction import mass_matrix
from ...scene.scene import Scene
from ...system.loops.kinematics import loop_jacobian
from ...system.loops.loop_assembly import assemble
from ...system.system import System
from ..stability.stability_verdict import Mode, Stability, Verdict
from .equilibrium_problem import Problem


@checks_arguments
@dataclass(frozen=True)
class Census:
    """The count of a search for relative equilibria, and the evidence for its completeness.

    Attributes:
        count: Number of distinct equilibria; a family counts once.
        families: Number of families among them.
        starts: Number of starts: random and symmetric ones, and walks from equilibria.
        converged: Number of starts that converged.
        seen_once: Number of equilibria that exactly one random start reached, directly or through
            an image under a symmetry.
        seen_twice: Number of equilibria that exactly two random starts reached.
        not_seen: Number of equilibria that only walks or minimisation reached.
        pending: Number of equilibria from which no walk started, because the limit was reached.
        morse_sum: Sum of (−1)^index over the equilibria in the unreduced shape space; None if an
            index is undefined or the sum does not apply.
        expected: Euler characteristic of that space, which the sum must equal; None if the sum
            does not apply.
        reason: Why the sum does not apply, or "".
    """

    count: int
    families: int
    starts: int
    converged: int
    seen_once: int
    seen_twice: int
    not_seen: int
    pending: int
    morse_sum: int | None
    expected: int | None
    reason: str

    @property
    def agrees(self) -> bool | None:
        """Whether the Morse sum is the expected one; None if it does not apply."""
        if self.morse_sum is None or self.expected is None:
            return None
        return self.morse_sum == self.expected

    @property
    def unseen(self) -> int:
        """Estimated number of missing equilibria, by Chao's estimator from the random starts.

        The estimator is a lower bound on average, and weak: equilibria with small basins do not
        contribute until a start has reached them.
        """
        once, twice = self.seen_once, self.seen_twice
        estimate = once * (once - 1) / (2.0 * (twice + 1.0))
        return max(0, math.ceil(estimate) - self.not_seen)

    @property
    def caveat(self) -> str:
        """The limitations of the search result, in full sentences."""
        if self.agrees is None:
            text = f"The Morse sum does not apply: {self.reason}. Equilibria can be missing."
        elif self.agrees:
            text = "Equilibria whose signs cancel in the sum can be missing."
        else:
            text = "Equilibria are missing, or are counted twice."
        if self.agrees is not None and self.families:
            text += " Families of odd dimension add nothing to the sum."
            text += " It does not show whether one is missing."
        if self.families:
            text += " Families of equal energy, index and dimension count as one."
        if self.pending:
            text += (
                f" The search stopped at its limit, before walks from {self.pending} equilibria: "
                "raise `limit`."
            )
        return text

    def __str__(self) -> str:
        counts = f"{self.seen_once} seen once, {self.seen_twice} twice"
        counts += f", estimated unseen {self.unseen} (Chao's estimator, a weak lower bound)"
        if self.agrees is None:
            return f"{counts}\n{self.caveat}"
        verb = "agrees with" if self.agrees else "differs from"
        text = f"Morse sum {self.morse_sum} {verb} the Euler characteristic {self.expected}"
        return f"{text}; {counts}\n{self.caveat}"


@checks_arguments
@dataclass(frozen=True, eq=False)
class RelativeEquilibrium(FrozenArrays):
    """A steady motion with constant shape.

    Attributes:
        system: The system.
        x: Shape, (nx,), with cyclic joints at zero.
        xdot: Shape rates, (m,), zero except for cyclic and driven joints.
        xi: Body twist, (r,).
        mu: Body momentum, (r,).
        direction: Direction of the momentum in the body, (3,), or the upward vertical where gravity
            rotates a pivoted base; (0,) for groups with one axis.
        momentum: Momentum J [N s | N m s], see `relative_equilibria`.
        amended_potential: Amended potential [J], with heights from the world origin.
        energy: Energy [J].
        residual: Largest remaining derivative, relative to the size of the energies.
        stability: Verdict, growth, frequencies and modes.
        problem: The problem that was solved.
    """

    system: System
    x: Array
    xdot: Array
    xi: Array
    mu: Array
    direction: Array
    momentum: float
    amended_potential: float
    energy: float
    residual: float
    stability: Stability
    problem: Problem = field(repr=False)

    @property
    def verdict(self) -> Verdict:
        """Verdict: "stable", "unstable" or "undecided"."""
        return self.stability.verdict

    @property
    def growth(self) -> float:
        """Largest growth rate [1/s]; zero if none exceeds its error."""
        return self.stability.growth

    @property
    def frequencies(self) -> Array:
        """Frequencies of undamped oscillations, sorted [rad/s]."""
        return self.stability.frequencies

    @property
    def modes(self) -> tuple[Mode, ...]:
        """Modes of the linearised reduced flow, largest growth first."""
        return self.stability.modes

    @property
    def dimension(self) -> int:
        """Dimension of the family of equilibria; zero for an isolated one."""
        return self.stability.dimension

    @property
    def damped_growth(self) -> Mapping[str, float]:
        """Growth rate per damping coefficient of each joint, if the verdict is "undecided"."""
        return self.stability.damped_growth

    def scene(
        self,
        mode: int | None = None,
        *,
        amplitude: float = 0.05,
        duration: float | None = None,
        times: Array | None = None,
    ) -> Scene:
        """Return the scene that starts in this motion, or on one of its modes.

        Args:
            mode: Index in `modes`.
            amplitude: Largest amplitude of the mode [rad | m].
            duration: Duration [s]; by default ten periods of the mode, or of the rotation.
            times: Report times [s].
        Returns:
            The scene.
        Raises:
            InputError: `mode` is not the index of a mode.
        """
        change = self._change(mode, amplitude)
        system, problem = self.system, self.problem
        x = system.space.integrate(self.x, change[: system.m])
        if system.closure is not None:
            x = assemble(system, x, system.closure.length)[0]
        pose = pose_of(problem, self.direction)
        pi, mu = self._momenta(change)
        if problem.kind == "heavy":
            gamma = -self.direction + change[2 * system.m : 2 * system.m + 3]
            pose = pose_of(problem, -gamma / np.linalg.norm(gamma))
        xdot, xi = self._velocity(x, pi, mu)
        if duration is None and times is None:
            duration = self._usual_duration(mode)
        return replace(
            problem.scene, x0=x, xdot0=xdot, xi0=xi, pose0=pose, duration=duration, times=times,
            outputs="all",
        )  # fmt: skip

    def _change(self, mode: int | None, amplitude: float) -> Array:
        """Return the perturbation of x (m,), joint momenta π (m,), and the base entries."""
        if mode is None:
            return np.zeros(2 * self.system.m + 6)
        if not 0 <= mode < len(self.modes):
            raise InputError(f"mode: expected an index below {len(self.modes)}, got {mode}")
        eigenmode = self.modes[mode]
        amplitudes = [
            eigenmode.shape,
            eigenmode.momentum,
            eigenmode.base,
            np.zeros(6 - len(eigenmode.base)),
        ]
        return amplitude * np.real(np.concatenate(amplitudes))

    def _momenta(self, change: Array) -> tuple[Array, Array]:
        """Return π (m,) of the joints and the body momentum (r,) after a perturbation."""
        system = self.system
        v = np.concatenate([self.xi, self.xdot])
        momentum = mass_matrix(system, self.x) @ v
        r, m = system.r, system.m
        mu, base = momentum[:r].copy(), change[2 * m :]
        if self.problem.kind == "heavy":
            mu += base[3:6]
        elif self.problem.kind == "free":
            mu[r - 3 :] += base[:3]
        return momentum[r:] + change[m : 2 * m], mu

    def _velocity(self, x: Array, pi: Array, mu: Array) -> tuple[Array, Array]:
        """Compute (ẋ, ξ) from the momenta; driven joints keep their prescribed rates."""
        system, problem = self.system, self.problem
        H = mass_matrix(system, x)
        driven = system.r + np.array(problem.driven, dtype=np.intp)
        free = np.setdiff1d(np.arange(system.n), driven)
        v = np.zeros(system.n)
        v[driven] = problem.driven_rate
        remaining = np.concatenate([mu, pi])[free] - H[np.ix_(free, driven)] @ v[driven]
        inertia = H[np.ix_(free, free)]
        v[free] = np.linalg.solve(inertia, remaining)
        if system.closure is not None:  # an impulse of the loops keeps them closed
            J = np.zeros((system.closure.rank, system.n))
            J[:, system.r :] = loop_jacobian(system, x)[system.closure.rows]
            response = np.linalg.solve(inertia, J[:, free].T)
            for _ in range(2):  # the second time removes round-off, which small rates reveal
                v[free] -= response @ np.linalg.solve(J[:, free] @ response, J @ v)
        return v[system.r :], v[: system.r]

    def _usual_duration(self, mode: int | None) -> float:
        rate = float(np.linalg.norm(self.xi[self.system.group.linear :]))
        if mode is not None:
            eigenmode = self.modes[mode]
            rate = abs(eigenmode.frequency) or 2.0 * np.pi * abs(eigenmode.growth) or rate
        return 20.0 * np.pi / rate if rate else 10.0

    def __str__(self) -> str:
        values = self.system.space.chart(self.x[None])[0]
        shape = ", ".join(
            f"{name}={value:.6g}"
            for name, value in zip(self.system.shape_names, values, strict=True)
        )
        return f"{shape or 'rigid'}: {self.verdict}{_growth(self.stability)}"


@checks_arguments
@dataclass(frozen=True, eq=False)
class Equilibria(Sequence[RelativeEquilibrium]):
    """The relative equilibria found by a search, sorted by amended potential.

    The list may be incomplete; the census states what shows whether it is.

    Attributes:
        system: The system.
        momentum: Momentum J [N s | N m s] of the search.
        census: Count of the search, its Morse sum, and what it cannot promise.
        entries: The equilibria.
    """

    system: System
    momentum: float
    census: Census
    entries: tuple[RelativeEquilibrium, ...]

    def __len__(self) -> int:
        return len(self.entries)

    @overload
    def __getitem__(self, index: int) -> RelativeEquilibrium: ...

    @overload
    def __getitem__(self, index: slice) -> tuple[RelativeEquilibrium, ...]: ...

    def __getitem__(
        self, index: int | slice
    ) -> RelativeEquilibrium | tuple[RelativeEquilibrium, ...]:
        return self.entries[index]

    def __iter__(self) -> Iterator[RelativeEquilibrium]:
        return iter(self.entries)

    @property
    def _count(self) -> str:
        census = self.census
        return (
            f"{len(self)} relative equilibria found at momentum {self.momentum:g}, from "
            f"{census.converged} of {census.starts} starts"
        )

    def __str__(self) -> str:
        head = f"{self.system.name or 'robot'}: {self._count}\n{self.census}"
        rows = [["", "amended V [J]", "verdict", "growth [1/s]", "frequencies [rad/s]", "shape"]]
        rows += [[str(k), *row] for k, row in enumerate(map(_row, self))]
        widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]) - 1)]
        lines = [
            "  ".join([*(c.ljust(w) for c, w in zip(row, widths, strict=False)), row[-1]]).rstrip()
            for row in rows
        ]
        lines += [f"{k}, by a damper: {_damped(e)}" for k, e in enumerate(self) if e.damped_growth]
        return "\n".join([head, *lines])

    def _repr_html_(self) -> str:
        from ...common.html import card, table

        columns = ["amended V [J]", "verdict", "growth [1/s]", "frequencies [rad/s]", "shape"]
        return card(
            self.system.name,
            f"{self._count}. {self.census}",
            table("", columns, [_row(equilibrium) for equilibrium in self]),
        )


def _row(equilibrium: RelativeEquilibrium) -> list[str]:
    """Format one row of a table: amended potential, verdict, growth, frequencies and shape."""
    swings = " ".join(f"{f:.5g}" for f in equilibrium.frequencies)
    values = equilibrium.system.space.chart(equilibrium.x[None])[0]
    shape = "(" + ", ".join(f"{value:.6g}" for value in values) + ")"
    if equilibrium.direction.size:
        shape += " about (" + ", ".join(f"{value:.4g}" for value in equilibrium.direction) + ")"
    verdict = equilibrium.verdict + (
        f", family of dimension {equilibrium.dimension}" if equilibrium.dimension else ""
    )
    growth = (
        f"{equilibrium.growth:.6g} ± {equilibrium.stability.growth_error:.0e}"
        if equilibrium.growth
        else ""
    )
    return [f"{equilibrium.amended_potential:.8g}", verdict, growth, swings, shape]


def _damped(equilibrium: RelativeEquilibrium) -> str:
    """Describe how dampers affect an equilibrium whose undamped stability test is undecided."""
    effects = [
        f"at {joint} it {'grows' if growth > 0.0 else 'decays'} by {abs(growth):.5g}"
        for joint, growth in equilibrium.damped_growth.items()
    ]
    return f"{', '.join(effects)} 1/s per N·m·s/rad | N·s/m"


def _growth(stability: Stability) -> str:
    if not stability.growth:
        return ""
    return f", grows by {stability.growth:.6g} ± {stability.growth_error:.1g} 1/s"


def pose_of(problem: Problem, up: Array) -> Array:
    """Return a pose of the base; if gravity rotates it, the body direction `up` points upward.

    Args:
        problem: The problem.
        up: Direction in the body, (3,); it has no effect if gravity does not rotate the base.
    Returns:
        Pose coordinates, (size,).
    """
    group = problem.system.group
    if problem.kind != "heavy":
        return group.identity()
    model = problem.system.sorted_model
    down = model.jointPlacements[1].rotation.T @ problem.system.gravity
    vertical = -down / np.linalg.norm(down)
    across, cosine = np.cross(up, vertical), float(up @ vertical)
    size = float(np.linalg.norm(across))
    if size < 1e-12:
        least = np.eye(3)[int(np.argmin(np.abs(up)))]
        across, size = np.cross(up, least), float(np.linalg.norm(np.cross(up, least)))
        return quaternion_exp((np.pi if cosine < 0.0 else 0.0) * across / size)
    return quaternion_exp(np.arctan2(size, cosine) * across / size)
