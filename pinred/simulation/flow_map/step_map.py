"""One step of a flow as a map of states and parameters, for shooting solvers."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ...common.argument_kinds import checks_arguments
from ...common.arrays import Array, FrozenArrays, positive
from ...common.errors import InputError
from ...common.names import brief
from ...scene.scene import Scene
from ...system.state_fields import Outcome, State

# Field of State for each input that is a part of the state, in the order of a flow's outputs.
STATE: dict[str, Outcome] = {"x0": "x", "xdot0": "xdot", "pose0": "pose", "xi0": "xi"}
_LATEST = 1e100  # [s]; the square of a time is finite, in which a body falls


@dataclass(frozen=True)
class LinearStep(FrozenArrays):
    """A step and its derivatives; arrays are read-only.

    Attributes:
        state: State at the end of the step.
        by_state: Derivative F_x of the tangent (x, ẋ, pose, ξ) at the end with respect to that at
            the start, (2n, 2n), in the order of `StepMap.outputs`; poses are in the body
            coordinates of their tangents.
        by_parameters: Derivative F_u of that tangent with respect to the parameters, (2n, nu).
    """

    state: State
    by_state: Array
    by_parameters: Array


@checks_arguments
class StepMap:
    """The map (state, parameters) → state of one step of constant length.

    The map takes one step of the flow's integrator without step control, so the map is smooth.

    Attributes:
        h: Length of the step [s].
        parameters: Number of entries by name of the flow's inputs that are not parts of the state,
            which are the controls of a shooting solver.
        outputs: Parts of the tangent of a state by name, which are those of `Flow.outputs` without
            other outputs.
        ndx: Length 2n of the tangent of a state.
        nu: Number of entries of all parameters.
    """

    def __init__(self, flow: Any, h: float) -> None:
        """Prepare the map.

        Args:
            flow: The Flow.
            h: Length of the step [s].
        Raises:
            InputError: The flow leaves out the base, or h is not positive.
        """
        self.h = positive(h, "h")
        scene: Scene = flow.scene
        if scene.outputs != "all":
            raise InputError("a step map needs the base; leave out outputs='shape'")
        start = scene.start
        complete = replace(
            scene, x0=start.x, xdot0=start.xdot, xi0=start.xi, pose0=start.pose, momentum=None,
            seed=None, keyframe=None, q0=None, v0=None,
        )  # fmt: skip
        names = [name for name in flow.inputs if name not in (*STATE, "momentum")]
        self._flow = flow.of_scene(complete, [*STATE, *names], tuple(STATE.values()))
        self.parameters = {name: self._flow.inputs[name] for name in names}
        self.outputs = self._flow.outputs
        self.ndx, self.nu = 2 * scene.system.n, sum(self.parameters.values())
        self._own = start

    def __repr__(self) -> str:
        name = self._flow.scene.system.name
        return f"StepMap({name!r}, {self.h:g} s, ndx = {self.ndx}, nu = {self.nu})"

    def __call__(self, state: Any = None, *, t: float = 0.0, **parameters: Any) -> State:
        """Compute the state after a step; see `linear`.

        Args:
            state: State at the start.
            t: Time at the start [s].
            **parameters: Values of parameters by name.
        Returns:
            The state at the end.
        """
        return self._step(state, t, parameters, derivatives=False).state

    def linear(self, state: Any = None, *, t: float = 0.0, **parameters: Any) -> LinearStep:
        """Compute the state after a step, with its derivatives.

        An InputError is raised for invalid arguments, and an IntegrationError if the step fails.

        Args:
            state: State at one time, or an object with pose, x, xdot and xi; None for the state
                of the scene.
            t: Time at the start of the step [s].
            **parameters: Values of parameters by name; omitted parameters have their values in
                the scene.
        Returns:
            The step.
        """
        return self._step(state, t, parameters, derivatives=True)

    def _step(
        self, state: Any, t: float, parameters: dict[str, Any], *, derivatives: bool
    ) -> LinearStep:
        for name in parameters:
            if name in STATE:
                raise InputError(f"a step map takes {name} in the state, its first argument")
        if not abs(t) < _LATEST:
            raise InputError(f"t: expected a time of at most {_LATEST:g} s, got {t:g}")
        at = self._own if state is None else state
        inputs: dict[str, Any] = dict(parameters)
        for name, field in STATE.items():
            field_value = getattr(at, field, None)
            if field_value is None:
                raise InputError(
                    f"a step map takes a State, with pose, x, xdot and xi; got {brief(state)}"
                )
            inputs[name] = np.asarray(field_value)
        end_state, slopes = self._flow.one_step(inputs, self.h, float(t), derivatives=derivatives)
        assert isinstance(end_state, State)
        return LinearStep(end_state, slopes[:, : self.ndx], slopes[:, self.ndx :])
