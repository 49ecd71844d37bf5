"""One step of a flow as a map of states and parameters, as shooting solvers want it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...common.arrays import Array, freeze, positive
from ...common.errors import InputError
from ...common.names import brief
from ...scene.scene import Scene
from ...system.state_fields import Outcome, State

# Of each input that is a part of the state, the field of State.
STATE: dict[str, Outcome] = {"pose0": "pose", "x0": "x", "xdot0": "xdot", "xi0": "xi"}


@dataclass(frozen=True)
class LinearStep:
    """A step and its derivatives; arrays are read-only.

    state: at its end.  by_state: (2n, 2n) F_x, of the tangent (pose, x, ẋ, ξ) at the end by that
    at the begin; poses in the body's coordinates of their tangents.  by_parameters: (2n, p) F_u, in
    the order of the map's parameters.
    """

    state: State
    by_state: Array
    by_parameters: Array

    def __post_init__(self) -> None:
        freeze(self)


class StepMap:
    """The map (state, parameters) → state of one step, of a length that stays.

    It is that of the flow's method, without step control, so that it is smooth.  h: its length [s].
    parameters: {name: size} those of the flow's inputs that are no states, the controls of a
    shooting solver.  ndx: 2n, the length of a state's tangent.  nu: how many numbers parameters
    have.
    """

    def __init__(self, flow: Any, h: float) -> None:
        """Take the flow of which it is a step.  Raises InputError."""
        self.h = positive(h, "h")
        scene: Scene = flow.scene
        if scene.outputs != "all":
            raise InputError("a step map needs the base; leave out outputs='shape'")
        start = scene.start
        whole = replace(
            scene, x0=start.x, xdot0=start.xdot, xi0=start.xi, pose0=start.pose, momentum=None,
            seed=None, keyframe=None, q0=None, v0=None,
        )  # fmt: skip
        names = [name for name in flow.inputs if name not in (*STATE, "momentum")]
        self._flow = flow.of_scene(whole, [*STATE, *names], tuple(STATE.values()))
        self.parameters = {name: self._flow.inputs[name] for name in names}
        self.ndx, self.nu = 2 * scene.system.n, sum(self.parameters.values())
        self._own = start

    def __repr__(self) -> str:
        name = self._flow.scene.system.name
        return f"StepMap({name!r}, {self.h:g} s, {self.ndx} numbers by them and {self.nu} more)"

    def __call__(self, state: Any = None, *, t: float = 0.0, **parameters: Any) -> State:
        """Return the state after a step; see `linear`."""
        return self._step(state, t, parameters, derivatives=False).state

    def linear(self, state: Any = None, *, t: float = 0.0, **parameters: Any) -> LinearStep:
        """Return the state after a step, with its derivatives.

        state: State at one time, or anything with its pose, x, xdot and xi; the scene's if None.
        t: the time at which the step begins [s].  Parameters that are not given have the scene's
        values.  Raises InputError, and IntegrationError where the step cannot be taken.
        """
        return self._step(state, t, parameters, derivatives=True)

    def _step(
        self, state: Any, t: float, parameters: dict[str, Any], *, derivatives: bool
    ) -> LinearStep:
        for name in parameters:
            if name in STATE:
                raise InputError(f"a step map takes {name} in the state, its first argument")
        at = self._own if state is None else state
        given: dict[str, Any] = dict(parameters)
        for name, field in STATE.items():
            part = getattr(at, field, None)
            if part is None:
                raise InputError(
                    f"a step map takes a State, with pose, x, xdot and xi; got {brief(state)}"
                )
            given[name] = np.asarray(part)
        end, slopes = self._flow.one_step(given, self.h, float(t), derivatives=derivatives)
        assert isinstance(end, State)
        return LinearStep(end, slopes[:, : self.ndx], slopes[:, self.ndx :])
