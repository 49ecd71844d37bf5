"""Rejection of motions whose flow has a derivative on one side only, or none, at joint stops.

A small change must not change the order of impacts. So a flow has no derivative where two joints
reach their stops at once, or where a joint grazes its stop or nearly does. The tolerance of the
scene decides what is at once, and what is near.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.polynomial import Chebyshev

from ...common.arrays import Array
from ...common.errors import InputError
from ...common.names import listed
from ...integrators.solution import Solution
from ...kernels.state_layout import Layout
from ...scene.scene import Scene
from ...scene.stop import Bound
from ..impacts import bernstein
from ..run_with_stops import Phase, StoppedMotion, margin_of

_DEGREE = 8  # Degree of the polynomials that describe gaps within a step.
_REAL = 1e-9  # Imaginary part of a real root, relative to the step.


class DoubtfulImpacts:
    """The checks of one motion."""

    def __init__(self, scene: Scene, motion: StoppedMotion) -> None:
        """Check the times of impacts.

        Args:
            scene: The scene with its stops.
            motion: Its motion.
        Raises:
            InputError: The flow gives states at the time of an impact.
        """
        self._scene, self._bounds = scene, scene.bounds
        self._within = scene.rtol * scene.end  # differences of times that count as none [s]
        self._last: tuple[float, frozenset[int]] = (-np.inf, frozenset())
        reports = scene.report_times
        for phase in motion.phases:
            if phase.impact is None or phase.start == 0.0:
                continue
            if np.abs(reports - phase.start).min() <= self._within:
                raise InputError(
                    f"stops: the flow gives the state at t = {phase.start:g} s, the time of an "
                    f"impact of {listed(list(phase.impact.joint), 8)}, where rates have no "
                    "derivative. Choose other times"
                )

    def tolerance(self, bound: Bound) -> float:
        """Return the distance from a stop that counts as none [rad | m]."""
        return self._scene.atol + self._scene.rtol * max(1.0, abs(bound.position))

    def refuse_start(self, x: Array, xdot: Array, wrt: Sequence[str]) -> None:
        """Reject derivatives by initial values of joints that start at their stops.

        Args:
            x: Initial shape, (nx,).
            xdot: Its rate, (m,).
            wrt: Names of the inputs with derivatives.
        Raises:
            InputError: The derivative is one-sided.
        """
        for bound in self._bounds:
            u = bound.sign * xdot[bound.v]
            if bound.sign * (x[bound.x] - bound.position) > margin_of(bound) or u > 0.0:
                continue
            for name in (f"{bound.joint}.stop.{bound.side}", "x0", "xdot0"):
                if name in wrt and (name != "xdot0" or u == 0.0):
                    raise InputError(
                        f"stops: joint '{bound.joint}' starts at its {bound.side} stop, so "
                        f"derivatives with respect to {name} are one-sided. Start away from the "
                        "stop, or omit this input"
                    )

    def refuse_together(
        self, t: float, x: Array, xdot: Array, hits: Sequence[Bound], rest: Collection[Bound]
    ) -> None:
        """Reject an impact whose order with another one the tolerances cannot decide.

        Args:
            t: Time of the impact [s].
            x: Shape, (nx,).
            xdot: Rates before it, (m,).
            hits: Stops of moving joints with an impulse.
            rest: Stops at which joints are at rest.
        Raises:
            InputError: Another joint is at its stop, or was a moment before.
        """
        joints = {bound.v for bound in hits}
        near = list(hits) if len(hits) > 1 else []
        for bound in self._bounds:
            u = bound.sign * xdot[bound.v]
            gap = bound.sign * (x[bound.x] - bound.position)
            near_gap = self.tolerance(bound) - u * self._within
            if bound.v not in joints and bound not in rest and u < 0.0 and gap <= near_gap:
                near.append(bound)
        speed = abs(xdot[hits[0].v])
        before, others = self._last
        if not others <= joints and t - before <= self._within + self.tolerance(hits[0]) / speed:
            near += [bound for bound in self._bounds if bound.v in others - joints]
        self._last = t, frozenset(joints)
        if near:
            names = list(dict.fromkeys(bound.joint for bound in (*hits, *near)))
            raise InputError(
                f"stops: {listed(names, 8)} reach their stops at one time, t = {t:g} s, so a flow "
                "has a derivative on each side only. Change the motion or a stop"
            )

    @staticmethod
    def refuse_touch(t: float, resting: Collection[Bound]) -> None:
        """Reject an event at which moving joints come to rest without an impulse."""
        for bound in resting:
            raise InputError(
                f"stops: joint '{bound.joint}' grazes its {bound.side} stop at t = {t:g} s, where "
                "a flow has no derivative. Change the motion or the stop"
            )

    @staticmethod
    def refuse_restitution(hits: Collection[Bound], wrt: Sequence[str]) -> None:
        """Reject derivatives with respect to a restitution that is zero, the least one."""
        for bound in hits:
            name = f"{bound.joint}.stop.restitution"
            if name in wrt and bound.stop.restitution == 0.0:
                raise InputError(
                    f"stops: the derivative with respect to {name} is one-sided at zero. Choose a "
                    "positive restitution, or omit this input"
                )

    def refuse_end(self, x: Array, xdot: Array, moving: Sequence[Bound]) -> None:
        """Reject a motion that ends as a joint reaches its stop."""
        for bound in moving:
            u, gap = bound.sign * xdot[bound.v], bound.sign * (x[bound.x] - bound.position)
            if u < 0.0 and gap <= self.tolerance(bound) - u * self._within:
                raise InputError(
                    f"stops: the flow ends as joint '{bound.joint}' reaches its {bound.side} stop, "
                    "where rates have no derivative. Choose another duration"
                )

    def refuse_near_misses(
        self, layout: Layout, moving: Sequence[Bound], start: float, solutions: Sequence[Solution]
    ) -> None:
        """Reject motions in which a joint nearly reaches its stop and turns back.

        Args:
            layout: Layout of the reduced states.
            moving: Stops of joints that do not rest.
            start: Start time of the first solution [s].
            solutions: Solutions between two events, in order of time.
        Raises:
            InputError: A joint comes within the tolerance of its stop without an impact.
        """
        at = {v: k for k, v in enumerate(layout.active)}
        at |= {v: 2 * layout.pairs + k for k, v in enumerate(layout.cyclic)}
        bounds = [bound for bound in moving if bound.v in at]
        if not bounds:
            return
        nodes, matrix = bernstein(_DEGREE)
        signs = np.array([bound.sign for bound in bounds])
        positions = np.array([bound.position for bound in bounds])
        tolerances = np.array([self.tolerance(bound) for bound in bounds])
        columns, is_open = [at[bound.v] for bound in bounds], np.zeros(len(bounds), dtype=bool)
        for solution in solutions:
            starts, lengths = solution.knots[:-1], np.diff(solution.knots)
            times = starts[:, None] + lengths[:, None] * nodes
            times[:, -1] = solution.knots[1:]
            y = solution.at(times.ravel())[:, columns].reshape(*times.shape, -1)
            gaps = signs * (y - positions)
            low = np.einsum("ij,sjb->sib", matrix, gaps).min(axis=1) <= tolerances
            for step, rows in enumerate(gaps):
                for k in np.flatnonzero(low[step] & is_open).tolist():
                    part = _turning(nodes, rows[:, k], tolerances[k])
                    if part is not None:
                        t = start + starts[step] + part * lengths[step]
                        raise InputError(
                            f"stops: joint '{bounds[k].joint}' grazes its {bounds[k].side} stop at "
                            f"t = {t:g} s, so a flow has a derivative on one side only. Change the "
                            "motion or the stop"
                        )
                is_open |= (rows > tolerances).any(axis=0)
            start += float(solution.knots[-1])


def rows_of(phase: Phase, bounds: Sequence[Bound]) -> dict[Bound, float]:
    """Return the stops with an impulse at the start of a phase, and the rates after it."""
    if phase.impact is None:
        return {}
    known = {(bound.joint, bound.side): bound for bound in bounds}
    keys = zip(phase.impact.joint, phase.impact.side, strict=True)
    return {known[key]: float(rate) for key, rate in zip(keys, phase.impact.rates[1], strict=True)}


def _turning(nodes: Array, gaps: Array, tolerance: float) -> float | None:
    """Return the place in [0, 1] of a minimum of a gap that is near zero, or None."""
    gap = Chebyshev.fit(nodes, gaps, len(nodes) - 1, domain=[0.0, 1.0])
    slope = gap.deriv()
    roots = slope.roots()
    for root in np.sort(roots.real[np.abs(roots.imag) <= _REAL]).tolist():
        if 0.0 <= root <= 1.0 and abs(gap(root)) <= tolerance and slope.deriv()(root) > 0.0:
            return float(root)
    return None
