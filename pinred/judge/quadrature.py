"""Residuals of motions in the equations of motion, integrated over intervals by Gauss's formula.

The defect of an interval from a to b is y(b) − y(a) − ∫ f(t, y(t)) dt. Here y is the full state and
f is Pinocchio's ABA. The formula has 8 nodes, so it is exact to round-off within the steps of
accurate integrators.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import legendre

from ..common.arrays import Array
from ..system.coordinates import Indices
from .full_dynamics import FullDynamics

NODES, _WEIGHTS = legendre.leggauss(8)
COUNT = len(NODES)
# Weights of the mean over an interval of ∫ f from its start: ½ ∫ (1 − s) f ds.
_MEAN_WEIGHTS = 0.5 * _WEIGHTS * (1.0 - NODES)
SLOPE_STEP = 1e-6  # step of directional difference quotients, relative to the sizes of states


def _partial_weights() -> Array:
    """Return the weights of ∫ f from −1 to each node, (8, 8)."""
    P = legendre.legvander(NODES, COUNT)
    previous = np.concatenate([-np.ones((COUNT, 1)), P[:, : COUNT - 1]], axis=1)
    # ∫ P_n from −1 is (P_{n+1} − P_{n−1})/(2n + 1), with P_{−1} = −1.
    integrals = (P[:, 1:] - previous) / (2 * np.arange(COUNT) + 1)
    return np.asarray(integrals @ np.linalg.inv(P[:, :COUNT]))


_PARTIAL_WEIGHTS = _partial_weights()


@dataclass(frozen=True)
class Quadrature:
    """Evaluations of ABA on P intervals with 8 nodes each.

    Attributes:
        nodes: Times of the nodes, (8 P,) [s].
        parameters: Force parameters at the nodes.
        y: Full states at the nodes, (8 P, n).
        rates: Rates of y by ABA, (8 P, n).
        defects: Defect over each interval, (P, n).
        mean_defects: Mean over the interval of the defect accumulated from its start, (P, n).
        largest_defects: Largest magnitude of the accumulated defect at the nodes, (P, n).
        lengths: Lengths of the intervals, (P,) [s].
    """

    nodes: Array
    parameters: Sequence[Array]
    y: Array
    rates: Array
    defects: Array
    mean_defects: Array
    largest_defects: Array
    lengths: Array


def node_times(a: Array, b: Array) -> Array:
    """Return the times of the nodes, (8 P,), of intervals from a to b, (P,) each."""
    return np.asarray((0.5 * (a + b)[:, None] + 0.5 * (b - a)[:, None] * NODES).ravel())


def integrate_residuals(
    full: FullDynamics,
    a: Array,
    b: Array,
    states: Callable[[Array], Array],
    numbers: Callable[[Array], Sequence[Array]],
) -> Quadrature:
    """Integrate the residuals of a motion over intervals.

    Args:
        full: Full dynamics of the scene.
        a: Starts of the intervals, (P,) [s].
        b: Ends of the intervals, (P,) [s].
        states: Function that returns the full states (T, n) of the motion at times (T,).
        numbers: Function that returns the force parameters at times (T,).
    Returns:
        The evaluations and the defects.
    """
    nodes, half = node_times(a, b), 0.5 * (b - a)
    start, end, y = np.split(states(np.concatenate([a, b, nodes])), [len(a), 2 * len(a)])
    parameters = numbers(nodes)
    rates = full.rates(nodes, y, parameters)
    course, at_nodes = y.reshape(len(a), COUNT, -1), rates.reshape(len(a), COUNT, -1)
    integral = half[:, None] * np.einsum("k,skn->sn", _WEIGHTS, at_nodes)
    mean_integral = half[:, None] * np.einsum("k,skn->sn", _MEAN_WEIGHTS, at_nodes)
    accumulated = course - start[:, None] - half[:, None, None] * (_PARTIAL_WEIGHTS @ at_nodes)
    return Quadrature(
        nodes=nodes,
        parameters=parameters,
        y=y,
        rates=rates,
        defects=end - start - integral,
        mean_defects=0.5 * np.einsum("k,skn->sn", _WEIGHTS, course) - start - mean_integral,
        largest_defects=np.abs(accumulated).max(axis=1),
        lengths=b - a,
    )


def propagate_residuals(
    full: FullDynamics, quadrature: Quadrature, first: Indices, sizes: Array
) -> Array:
    """Propagate residuals inside steps to the step ends.

    The integral of the residual over a step can vanish although the step end is wrong: for linear
    equations, the dense-output interpolants have this property. The accumulated defect D(t) is
    therefore propagated through the linearised ABA dynamics: e = D + z, where z' = J (D + z). The
    Jacobian J is evaluated at the midpoint of each interval.

    Args:
        full: Full dynamics of the scene.
        quadrature: Evaluations on P intervals, which are parts of S steps.
        first: Index of the first interval of each step, (S,).
        sizes: Sizes of states, (n,), which scale difference quotients.
    Returns:
        Errors at the step ends, (S, n).
    """
    counts = np.diff(np.append(first, len(quadrature.lengths)))
    errors = np.zeros((len(first), quadrature.defects.shape[1]))
    for k in range(int(counts.max(initial=0))):
        steps = np.flatnonzero(counts > k)  # the steps with an interval k
        intervals, before = first[steps] + k, errors[steps]
        mean = before + quadrature.mean_defects[intervals]
        mean += 0.5 * growth_over(full, quadrature, intervals, mean, sizes)
        grown = growth_over(full, quadrature, intervals, mean, sizes)
        errors[steps] = before + quadrature.defects[intervals] + grown
    return errors


def growth_over(
    full: FullDynamics, quadrature: Quadrature, intervals: Indices, errors: Array, sizes: Array
) -> Array:
    """Compute J · error times the length of an interval; J · error is a difference quotient.

    Args:
        full: Full dynamics of the scene.
        quadrature: Evaluations on all intervals.
        intervals: Indices of intervals, (I,).
        errors: An error of the state in each of them, (I, n).
        sizes: Sizes of states, (n,), which scale the difference.
    Returns:
        (I, n) growth; zero for an error that is zero or not finite.
    """
    units = np.abs(errors / sizes).max(axis=1) / SLOPE_STEP
    growth, regular = np.zeros_like(errors), (units > 0.0) & (units < np.inf)
    nodes, units = intervals[regular] * COUNT + COUNT // 2, units[regular, None]
    parameters = [quadrature.parameters[k] for k in nodes]
    states = quadrature.y[nodes] + errors[regular] / units
    change = full.rates(quadrature.nodes[nodes], states, parameters) - quadrature.rates[nodes]
    growth[regular] = quadrature.lengths[intervals[regular], None] * units * change
    return growth
