"""States whose fields are made when they are looked at."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from ...common.arrays import Array, read_only
from ...kernels.layout import Outputs
from ...system.state_fields import ShapeState, State
from ...system.system import System


class LaterState(State):
    """A State of which each field is made of a kernel's outputs when first looked at."""

    def __getattr__(self, name: str) -> Any:
        return _made(self, State, name)

    def __reduce__(self) -> tuple[Any, ...]:
        return State, tuple(getattr(self, name) for name in State.__dataclass_fields__)


class LaterShapeState(ShapeState):
    """The same without the base."""

    def __getattr__(self, name: str) -> Any:
        return _made(self, ShapeState, name)

    def __reduce__(self) -> tuple[Any, ...]:
        return ShapeState, tuple(getattr(self, name) for name in ShapeState.__dataclass_fields__)


def made_later(
    system: System, where: Outputs, t: float, outputs: Callable[[], Array], *, wanted: bool
) -> State | ShapeState:
    """Return the state at time t [s] that is in outputs, (where.size,), made at the first look."""
    state: Any = object.__new__(LaterState if wanted else LaterShapeState)
    vars(state)["_later"] = (system, where, t, outputs)
    return state  # type: ignore[no-any-return]


def _made(state: Any, kind: type, name: str) -> Any:
    """Return a field, and keep it."""
    kept = vars(state)
    if name not in kind.__dataclass_fields__ or "_later" not in kept:  # type: ignore[attr-defined]
        raise AttributeError(name)
    system, where, t, outputs = kept["_later"]
    out = kept.get("_outputs")
    if out is None:
        out = kept["_outputs"] = outputs()
    if name == "t":
        value = np.array(t)
    elif name == "energy":
        value = out[-1:].reshape(())
    elif name == "xi":
        value = out[where.v][: system.r]
    elif name == "q":
        value = system.given_q(out[where.q])
    elif name == "v":
        value = system.given_v(out[where.v])
    else:
        value = out[getattr(where, name)]
    kept[name] = read_only(value)
    return value
