"""The map from inputs of a flow to its reduced state, parameters and centre-of-mass path."""

from __future__ import annotations

import numpy as np

from ...common.arrays import Array
from ...common.errors import InputError
from ...forces.force_numbers import Tables
from ...kernels.build import expect_code
from ...kernels.flow_functions import initial_conditions_of
from ...kernels.initial_conditions import TwistOrMomentum
from ...kernels.kernel import Kernel, call_value, evaluate
from ..compiled.compiled_flow import CompiledFlow
from .inputs import Given


class InitialMap:
    """The map from input columns to reduced state, parameters and centre-of-mass path.

    The input columns are the fields of Given: `state` and `constants`, which end with the free-fall
    acceleration of the centre of mass.  A reduced state without entries is replaced by one zero,
    because integrators need at least one entry.
    """

    def __init__(self, kernel: Kernel, motion: TwistOrMomentum, tables: Tables | None) -> None:
        """Prepare the map.

        Args:
            kernel: Kernel of the flow.
            motion: Whether inputs have a body twist ("xi") or a body momentum ("mu").
            tables: Tables in the forces; None without forces.
        """
        self._tables = tables
        layout, k = kernel.layout, kernel.system.group.linear
        self._kernel, self._function = kernel, initial_conditions_of(kernel, motion)
        self._address = self._function.value.address
        self._cuts = [layout.size, layout.size + layout.gravity_at]
        self._size, self._fall = self._cuts[1] + 2 * k, k
        self._hole, self._path = layout.com_path_at - layout.gravity_at, layout.com_path

    def __call__(self, given: Given, t: float = 0.0) -> CompiledFlow:
        """Return the flow that starts from inputs.

        Args:
            given: The inputs.
            t: Start time [s]; the centre-of-mass path is stated at time zero.
        Returns:
            The flow.
        Raises:
            InputError: The momentum or twist overflows.
        """
        constants, fall = self._split(given.constants)
        outputs = np.empty(self._size)
        call_value(self._address, given.state, self._with_path(constants, None), outputs)
        _refuse_overflow(outputs)
        y, head, start = self._pieces(outputs)
        path = _moved_back(t, np.concatenate([start, fall]), self._fall)
        parameters = np.concatenate([head, self._with_path(constants, path)])
        y0 = y if y.size else np.zeros(1)
        return CompiledFlow(self._kernel, self._tables, y0, parameters, path)

    def of_many(self, states: Array, constants: Array) -> CompiledFlow:
        """Return the flow of N inputs, rows of states and constants.  Raises InputError."""
        other_constants, falls = self._split(constants.T)
        kernel_constants = np.ascontiguousarray(self._with_path(other_constants, None).T)
        outputs = evaluate(self._address, kernel_constants, states, self._size)
        _refuse_overflow(outputs)
        y, head, start = self._pieces(outputs.T)
        path = np.vstack([start, falls])
        parameters = np.vstack([head, self._with_path(other_constants, path)])
        columns = (np.ascontiguousarray(each.T) for each in (y, parameters, path))
        return CompiledFlow(self._kernel, self._tables, *columns)

    def along_many(
        self, states: Array, constants: Array, directions: tuple[Array, Array]
    ) -> tuple[Array, Array, Array]:
        """Return derivatives of the flow of N inputs along D directions of each.

        Args:
            states: States of the inputs, (N, …).
            constants: Constants of the inputs, (N, …).
            directions: Directions of both, (N, …, D), or (1, …, D) for all inputs.
        Returns:
            Derivatives of the reduced states (N, n, D), the parameters (N, p, D) and the paths
            (N, 3k, D).
        """
        by_state, by_constants = directions
        # The entries come first here, as in `along`.
        known, falls = self._split(np.moveaxis(by_constants, 0, 1))
        points = self._with_path(self._split(constants.T)[0], None).T
        derivatives = self._function.forward_many(
            states, points, by_state, np.moveaxis(self._with_path(known, None), 1, 0), self._size
        )
        y, head, start = self._pieces(np.moveaxis(derivatives, 0, 1))
        shape = (len(states), by_state.shape[2])
        known, falls = (np.broadcast_to(a, (len(a), *shape)) for a in (known, falls))
        path = np.concatenate([start, falls])
        parameters = np.concatenate([head, self._with_path(known, path)])
        y = y if len(y) else np.zeros((1, *shape))
        return np.moveaxis(y, 0, 1), np.moveaxis(parameters, 0, 1), np.moveaxis(path, 0, 1)

    def expect_along(self) -> None:
        """Let other threads generate the machine code of `along`."""
        expect_code(lambda: self._function.tangent)

    def expect_back(self) -> None:
        """Let other threads generate the machine code of `back`."""
        expect_code(lambda: self._function.adjoint)

    def along(
        self, given: Given, state: Array, constants: Array, t: float = 0.0
    ) -> tuple[Array, Array, Array]:
        """Return derivatives along N directions of the inputs.

        Args:
            given: The inputs.
            state: Directions of the inputs' state, (…, N).
            constants: Directions of the inputs' constants, (…, N).
            t: Start time [s].
        Returns:
            Derivatives of the reduced state (n, N), the parameters (p, N) and the path (3k, N).
        """
        constants, falls = self._split(constants)
        kernel_constants, directions = self._known(given), self._with_path(constants, None)
        derivatives = self._function.forward(
            given.state, kernel_constants, state, directions, self._size
        )
        y, head, start = self._pieces(derivatives)
        path = _moved_back(t, np.vstack([start, falls]), self._fall)
        parameters = np.vstack([head, self._with_path(constants, path)])
        return y if len(y) else np.zeros((1, state.shape[1])), parameters, path

    def back(
        self, given: Given, by_y: Array, by_parameters: Array, by_path: Array
    ) -> tuple[Array, Array]:
        """Return the cotangents of the inputs' state and constants.

        Args:
            given: The inputs.
            by_y: Cotangent of the reduced state, (n,).
            by_parameters: Cotangent of the parameters, (p,).
            by_path: Cotangent of the path, (3k,).
        Returns:
            Cotangents of `state` and of `constants`.
        """
        size, head = self._cuts[0], self._cuts[1] - self._cuts[0]
        if self._path:
            first = head + self._hole
            by_path = by_path.copy()
            by_path[: self._path] += by_parameters[first : first + self._path]
        starts = len(by_path) - self._fall
        covector = np.concatenate([by_y[:size], by_parameters[:head], by_path[:starts]])
        state, constants = self._function.reverse(given.state, self._known(given), covector)
        constants += by_parameters[head:]
        if self._path:
            constants = np.delete(constants, np.s_[self._hole : self._hole + self._path])
        return state, np.concatenate([constants, by_path[starts:]])

    def _pieces(self, out: Array) -> tuple[Array, Array, Array]:
        """Split outputs into reduced state, first parameters, and position and velocity."""
        first, second = self._cuts
        return out[:first], out[first:second], out[second:]

    def _known(self, given: Given) -> Array:
        return self._with_path(self._split(given.constants)[0], None)

    def _with_path(self, constants: Array, path: Array | None) -> Array:
        """Insert the path into the constants if forces depend on the path; None inserts zeros."""
        if not self._path:
            return constants
        if path is None:
            path = np.zeros((self._path, *constants.shape[1:]))
        return np.concatenate([constants[: self._hole], path, constants[self._hole :]])

    def _split(self, constants: Array) -> tuple[Array, Array]:
        """Split input constants into the kernel's constants and the free-fall acceleration."""
        at = len(constants) - self._fall
        return constants[:at], constants[at:]


def _refuse_overflow(out: Array) -> None:
    if not np.isfinite(out).all():
        raise InputError("the initial momentum or twist overflows; reduce rates or momentum")


def _moved_back(t: float, path: Array, k: int) -> Array:
    """Return the path (3k, …), stated at time zero, from its position and velocity at time t."""
    if t == 0.0:
        return path
    start, velocity, fall = path[:k], path[k : 2 * k], path[2 * k :]
    return np.concatenate([start - t * velocity + 0.5 * t**2 * fall, velocity - t * fall, fall])
