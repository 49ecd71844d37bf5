"""Assembly of the reduced state, the parameters and the centre-of-mass path at the start of a flow.

Usually all entries are copies: of the initial state, of the initial conditions, and of constants.
For scenes of one structure, the indices of these copies are therefore computed once.
"""

from __future__ import annotations

from dataclasses import dataclass
from weakref import ref

import numpy as np

from ...common.arrays import Array
from ...kernels.evaluate import evaluate_row
from ...kernels.initial_conditions import InitialConditions, InitialConditionsKernel
from ...kernels.kernel import Kernel
from ...kernels.state_layout import Layout
from ...scene.initial_state import GivenStates, finite_start
from ...system.coordinates import Indices


@dataclass(frozen=True)
class Constants:
    """Numbers of a flow that do not depend on the initial state, (…) or (N, …).

    Attributes:
        gravity: Gravity, as in Acting, (…, 3) [m/s²].
        fall: Acceleration of the centre of mass in free fall, (…, k) [m/s²].
        bodies: Variable body parameters, (…, s).
        numbers: Force parameters, (…, p).
    """

    gravity: Array
    fall: Array
    bodies: Array
    numbers: Array


def assemble(
    layout: Layout, given: GivenStates, start: InitialConditions, constants: Constants, down: Array
) -> tuple[Array, Array, Array]:
    """Return the reduced states, (N, k), the parameters, (N, p), and the paths, (N, 3k).

    Args:
        layout: Layout of states and parameters.
        given: Initial states of N members.
        start: Their reduced initial conditions.
        constants: Further numbers.
        down: Directions of the weight in the body frame, (N, layout.base.down).
    Returns:
        The arrays.
    """
    base, N, k = layout.base, len(given.x), start.c0.shape[1]
    attitude = given.pose[:, k : k + base.attitude]
    y0 = np.concatenate(
        [
            *layout.shape_entries(given.x, start.pi), attitude, down,
            start.about[:, : base.momentum], np.zeros((N, base.push + layout.clock)),
        ],
        axis=1,
    )  # fmt: skip
    path = _fill(np.empty((N, 3 * k)), [start.c0, start.v0, constants.fall])
    parameters = _fill(
        np.empty((N, layout.parameters)),
        [
            start.fixed[:, : base.spin], start.pi[:, layout.constant_pi],
            constants.gravity[..., list(layout.gravity)], constants.bodies,
            path[:, : layout.com_path], constants.numbers,
        ],
    )  # fmt: skip
    return y0, parameters, path


def _fill(rows: Array, columns: list[Array]) -> Array:
    """Concatenate columns (N, …), or (…) if all members share them, into `rows`; return `rows`."""
    first = 0
    for column in columns:
        if width := column.shape[-1]:
            rows[:, first : first + width] = column
            first += width
    return rows


@dataclass(frozen=True, eq=False)
class StartConditions:
    """The kernel of initial conditions, prepared for single states of one structure.

    Attributes:
        kernel: The kernel.
        numbers: Values of the variable body parameters, (1, s).
        about: Indices of the angular momentum about the centre of mass in the conditions.
        size: Number of conditions.
    """

    kernel: InitialConditionsKernel
    numbers: Array
    about: slice
    size: int

    @classmethod
    def of(cls, kernel: InitialConditionsKernel) -> StartConditions:
        """Return the prepared kernel."""
        return cls(kernel, kernel.own_numbers[None], kernel.about, kernel.size)

    def at(self, given: GivenStates) -> tuple[Array, Array]:
        """Return a state, (1, k), with its initial conditions, (1, size)."""
        state = np.concatenate([given.pose, given.x, given.xdot, given.motion], axis=1)
        values = np.empty((1, self.size))
        evaluate_row(self.kernel.code.address, self.numbers, state, values)
        return state, values


@dataclass(frozen=True, eq=False)
class PreparedStart:
    """The indices of all copies at the start of a flow, for scenes of one structure.

    Attributes:
        kernel: Weak reference to the kernel of the flow.  A structure does not keep kernels beyond
            those that a system keeps.
        constants: Zero, and the numbers that the scenes share, (c,).
        at: Indices of the reduced state (k,), the parameters (p,) and the path (3k,) in (constants,
            initial state, initial conditions).
        ends: Ends of the reduced state and of the parameters in `at`: k and k + p.
    """

    kernel: ref[Kernel]
    constants: Array
    at: Indices
    ends: tuple[int, int]

    def start(self, state: Array, conditions: Array) -> tuple[Array, Array, Array]:
        """Return the reduced state, the parameters and the path at the start.

        Args:
            state: Pose, shape, shape rate and body twist or momentum, one after another.
            conditions: Outputs of the kernel of initial conditions.
        Returns:
            The arrays, (k,), (p,) and (3k,).
        Raises:
            InputError: A number is not finite.
        """
        numbers = np.concatenate([self.constants, state, conditions])[self.at]
        finite_start(numbers)
        k, p = self.ends
        return numbers[:k], numbers[k:p], numbers[p:]


def prepare_start(
    kernel: Kernel, given: GivenStates, conditions: InitialConditionsKernel, constants: Constants
) -> PreparedStart | None:
    """Return the indices of all copies; None if some entries must be computed.

    Args:
        kernel: Kernel of the flow.
        given: An initial state.
        conditions: Kernel of initial conditions.
        constants: Further numbers, each (…).
    Returns:
        The indices.
    """
    layout = kernel.layout
    if layout.base.down or layout.lifted_balls:
        return None
    count = 1  # Index 0 holds the constant zero, for entries that start at zero.

    def indices(array: Array) -> Array:
        nonlocal count
        count += array.shape[-1]
        return np.arange(count - array.shape[-1], count, dtype=float)

    shared = {name: indices(array) for name, array in vars(constants).items()}
    pose, x, xdot, motion = (
        indices(a)[None] for a in (given.pose, given.x, given.xdot, given.motion)
    )
    outputs = conditions.split(np.arange(count, count + conditions.size, dtype=float)[None])
    states, down = GivenStates(pose, x, xdot, motion, None), np.empty((1, 0))
    arrays = assemble(layout, states, outputs, Constants(**shared), down)
    values = np.concatenate([np.zeros(1), *vars(constants).values()])
    whole = np.concatenate(arrays, axis=1)
    if not (np.isin(whole, np.arange(count + conditions.size))).all():
        return None
    ends = arrays[0].shape[1], arrays[0].shape[1] + arrays[1].shape[1]
    prepared = PreparedStart(ref(kernel), values, whole[0].astype(np.intp), ends)
    return prepared if _are_copies(prepared, layout, given, conditions, constants) else None


def _are_copies(
    prepared: PreparedStart,
    layout: Layout,
    given: GivenStates,
    conditions: InitialConditionsKernel,
    constants: Constants,
) -> bool:
    """Return whether all entries are copies, tested with random numbers."""
    rng, down = np.random.default_rng(0), np.empty((1, 0))
    pose, x, xdot, motion = (
        rng.random(a.shape) for a in (given.pose, given.x, given.xdot, given.motion)
    )
    states = GivenStates(pose, x, xdot, motion, None)
    outputs = rng.random((1, conditions.size))
    expected = assemble(layout, states, conditions.split(outputs), constants, down)
    state = [states.pose[0], states.x[0], states.xdot[0], states.motion[0]]
    copies = prepared.start(np.concatenate(state), outputs[0])
    return all(np.array_equal(a[0], b) for a, b in zip(expected, copies, strict=True))
