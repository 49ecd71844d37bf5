"""The options of a Scene by name and type, for functions that take them as `**options`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypedDict

from numpy.typing import ArrayLike

from ..forces.force import Force
from ..forces.signals import Signal
from ..integrators.methods import Method
from .event import Event
from .scene import WantedOutputs


class SceneOptions(TypedDict, total=False):
    """The fields of Scene but for its system; `Scene` says what each means."""

    x0: ArrayLike | Mapping[str, ArrayLike] | None
    xdot0: ArrayLike | Mapping[str, ArrayLike] | None
    xi0: ArrayLike | None
    momentum: ArrayLike | None
    seed: int | None
    keyframe: str | None
    pose0: Any
    q0: ArrayLike | None
    v0: ArrayLike | None
    duration: float | None
    times: ArrayLike | None
    rtol: float
    atol: float
    springs: Mapping[str, tuple[float, float]]
    forces: Sequence[Force] | Force
    prescribed: Mapping[str, Signal | float | str]
    passive: bool
    friction: float | None
    parameters: Any
    events: Sequence[Event] | Event
    outputs: WantedOutputs
    method: Method | str
