"""States whose fields are read from a kernel's outputs at first access."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import numpy as np

from ...common.arrays import Array, read_only
from ...kernels.kernel import Outputs
from ...system.state_fields import ShapeState, State, arrays_of
from ...system.system import System


class _ReadOnAccess:
    """A state whose fields are computed by `read` at first access and then cached."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    def __init__(self, read: Callable[[str], Array]) -> None:
        vars(self)["_read"] = read

    def __getattr__(self, name: str) -> Any:
        if name not in self.__dataclass_fields__ or "_read" not in vars(self):
            raise AttributeError(name)
        value = vars(self)[name] = read_only(vars(self)["_read"](name))
        return value


class LazyState(_ReadOnAccess, State):
    """A State whose fields are computed at first access."""

    def __reduce__(self) -> tuple[Any, ...]:
        return State, tuple(arrays_of(self).values())


class LazyShapeState(_ReadOnAccess, ShapeState):
    """A ShapeState whose fields are computed at first access."""

    def __reduce__(self) -> tuple[Any, ...]:
        return ShapeState, tuple(arrays_of(self).values())


def lazy_state(
    system: System, where: Outputs, t: float, outputs: Callable[[], Array], *, wanted: bool
) -> State | ShapeState:
    """Return the state at one time whose fields are computed at first access.

    Args:
        system: The system of the kernel.
        where: Slices of the outputs.
        t: Time [s].
        outputs: Function that computes the kernel's outputs, (where.size,); called once.
        wanted: Whether the scene requests the base, so that the outputs contain it.
    Returns:
        A State with the base, a ShapeState without it.
    """
    computed: list[Array] = []

    def read(name: str) -> Array:
        if name == "t":
            return np.array(t)
        if not computed:
            computed.append(outputs())
        return where.read_field(name, computed[0], system)

    return LazyState(read) if wanted else LazyShapeState(read)
