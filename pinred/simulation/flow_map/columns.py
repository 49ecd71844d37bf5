"""A flow between plain columns of numbers, as other people's languages want it.

Inputs are columns in the order of the flow's `inputs`; the output is one column.  A pose in it has
its own coordinates, not those of its tangent, so that values and derivatives belong together.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...common.arrays import Array
from ...common.errors import InputError


class Columns:
    """A flow as a function of columns.

    names, sizes: of its inputs.  starts: their values in the scene.  size: of the output, of all
    times one after another.  outputs: the places of State's fields in that of one time.
    """

    def __init__(self, flow: Any) -> None:
        """Take a Flow.  Raises InputError for inputs that are no vectors."""
        if "pose0" in flow.inputs:
            raise InputError(
                "pose0 is a point of a group, and no vector of which this could be a function; "
                "make the flow without it among wrt"
            )
        if not flow.inputs:
            raise InputError("the flow has no inputs with derivatives; name some as wrt=")
        self.flow = flow
        self.names, self.sizes = tuple(flow.inputs), tuple(flow.inputs.values())
        self.starts = [flow.own(name) for name in self.names]
        self._times = len(flow.t) if flow.over_times else 1
        self.outputs, at = {}, 0
        for name, place in flow.outputs.items():
            width = flow.system.group.size if name == "pose" else place.stop - place.start
            self.outputs[name] = slice(at, at + width)
            at += width
        self.size = at * self._times

    def value(self, *columns: Any) -> Array:
        """Return the output, (size,)."""
        states = self.flow(**self._named(columns))
        parts = [np.reshape(getattr(states, name), (self._times, -1)) for name in self.outputs]
        return np.hstack(parts).ravel()

    def jacobian(self, *columns: Any) -> list[Array]:
        """Return the derivatives of the output by each input, (size, its size)."""
        named = self._named(columns)
        found = self.flow.jacobian(**named)
        frames = self._frames(named)
        out = []
        for name, size in zip(self.names, self.sizes, strict=True):
            rows = found[name].reshape(self._times, -1, size)
            parts = [
                frames @ rows[:, place] if key == "pose" else rows[:, place]
                for key, place in self.flow.outputs.items()
            ]
            out.append(np.concatenate(parts, axis=1).reshape(self.size, size))
        return out

    def jvp(self, columns: Sequence[Any], along: Sequence[Any]) -> Array:
        """Return the derivative of the output along directions of the inputs, (size,)."""
        named = self._named(columns)
        directions = dict(zip(self.names, along, strict=True))
        rows = self.flow.jvp(directions, **named).reshape(self._times, -1)
        frames = self._frames(named)
        parts = [
            (frames @ rows[:, place, None])[..., 0] if key == "pose" else rows[:, place]
            for key, place in self.flow.outputs.items()
        ]
        return np.hstack(parts).ravel()

    def vjp(self, columns: Sequence[Any], covector: Any) -> list[Array]:
        """Return the derivatives of covector · output by each input, (its size,)."""
        named = self._named(columns)
        whole = np.reshape(np.asarray(covector, dtype=float), (self._times, -1))
        frames = self._frames(named)
        parts = [
            np.einsum("tij,ti->tj", frames, whole[:, place]) if key == "pose" else whole[:, place]
            for key, place in self.outputs.items()
        ]
        rows = np.hstack(parts)
        found = self.flow.vjp(rows if self.flow.over_times else rows[0], **named)
        return [np.atleast_1d(found[name]) for name in self.names]

    def _named(self, columns: Sequence[Any]) -> dict[str, Array]:
        arrays = [np.ravel(np.asarray(column, dtype=float)) for column in columns]
        return dict(zip(self.names, arrays, strict=True))

    def _frames(self, named: dict[str, Array]) -> Array:
        """Return the maps, (T, size, r), from tangents of the pose to its coordinates."""
        if "pose" not in self.outputs:
            return np.empty(0)
        group, states = self.flow.system.group, self.flow(**named)
        poses = np.reshape(states.pose, (self._times, -1))
        return np.array(
            [np.transpose([group.rate(pose, e) for e in np.eye(group.dim)]) for pose in poses]
        )
