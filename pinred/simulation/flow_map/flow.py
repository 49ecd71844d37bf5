"""flow(): a scene as a map from initial state and parameters to states, with derivatives.

`Flow.step` is one step of this map, for shooting solvers.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Unpack, get_args

import numpy as np

from ...common.argument_kinds import checks_arguments, shows_fields
from ...common.arrays import Array, FrozenArrays, as_floats, positive
from ...common.errors import InputError, SceneWarning, ShapeError
from ...common.memo import once
from ...common.names import brief, listed, nearest, quoted
from ...scene.scene import Scene
from ...scene.scene_options import SceneOptions
from ...system.state_fields import FIELDS, Outcome, ShapeState, State
from ...system.system import System
from ..compiled.code_ahead import expect_integration
from ..plan import plan_of
from ..simulate import as_scene, free_joints_notice
from .inputs import Inputs, motion_of, with_varied

if TYPE_CHECKING:
    from .flow_columns import Columns, FlowCallback
    from .run_and_adjoint import Run

_ROWS: tuple[Outcome, ...] = get_args(Outcome)
_ALL: tuple[Outcome, ...] = ("x", "xdot", "pose", "xi")
_SHAPE: tuple[Outcome, ...] = ("x", "xdot")


@checks_arguments
class Flow:
    """The map of a scene from inputs to states, with derivatives.

    Inputs are x0, xdot0, pose0, xi0 or momentum (whichever the scene states), and names of
    Parameters.  Inputs that a call omits have their values in the scene.  Derivatives are those of
    the integrator's steps, with the step lengths held constant.  A pose g among inputs or outputs
    is differentiated in body coordinates: with respect to η at η = 0 in g exp(η̂).  Likewise, the
    attitude R of a ball joint in a shape is differentiated with respect to w in R exp(ŵ).  With
    closed loops, the shape and its rate are projected to a closed state as in `simulate`, and
    derivatives contain this projection.  With joint stops, states are those of `simulate`, and
    derivatives jump at impacts, rests and releases; the numbers of stops are inputs, such as
    "elbow.stop.upper" and "elbow.stop.restitution".  Where Parameters of prescribed joints move
    them at time 0, the other joints follow by the loops from the scene's shape.

    Attributes:
        scene: The scene.
        inputs: Names of the inputs with derivatives, and the number of entries of each.
        outputs: Names of the outputs with derivatives (fields of State), and their rows.
        over_times: Whether the flow gives states at the report times, or the state at the end.
        propagator: Kernels and integrations, used by adapters.
        input_map: Columns of the inputs, used by adapters.
    """

    def __init__(
        self, scene: Scene, wrt: Sequence[str], of: Sequence[Outcome] | None, *, over_times: bool
    ) -> None:
        """Prepare the flow of a scene; `pinred.flow` is the usual constructor.

        Args:
            scene: The scene, in which robot parameters among `wrt` are variable.
            wrt: Names of the inputs with derivatives.
            of: Names of the outputs with derivatives; x, xdot, pose and xi if None.
            over_times: Whether the flow gives states at the report times, or the state at the end.
        """
        self.scene = scene
        # The scene keeps its own report times, for pinred.simulate(flow.scene).
        reported = scene if over_times else replace(scene, times=np.array([scene.end]))
        plan = plan_of(reported)
        self.over_times = over_times
        expect_integration(plan.method)  # before the kernels are imported
        from ...kernels.flow_functions import sizes_of
        from .flow_through_stops import StoppedPropagator
        from .propagator import Propagator

        zero = _stays_zero(scene, wrt)
        self.propagator = (
            StoppedPropagator(reported, wrt, zero_momentum=zero)
            if scene.bounds
            else Propagator(plan, zero_momentum=zero)
        )
        self.input_map = Inputs(scene, self.propagator.kernel, plan.gravity, wrt)
        self._rows = _checked_rows(of, wanted=plan.wanted)
        sizes = sizes_of(scene.system)
        ends = np.cumsum([0, *(sizes[outcome] for outcome in self._rows)]).tolist()
        self.outputs: Mapping[str, slice] = MappingProxyType(
            dict(zip(self._rows, map(slice, ends, ends[1:]), strict=True))
        )
        self.inputs: Mapping[str, int] = MappingProxyType(self.input_map.sizes)
        self._size = ends[-1]
        self._last: tuple[bytes, Run] | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        flow = partial(Flow, over_times=self.over_times)
        return flow, (self.scene, self.input_map.names, self._rows)

    def __repr__(self) -> str:
        inputs = ", ".join(f"{name} ({size})" for name, size in self.inputs.items()) or "nothing"
        outputs = ", ".join(f"{name} ({p.stop - p.start})" for name, p in self.outputs.items())
        return f"Flow({self.scene.system.name!r}, {self.scene.end:g} s, {outputs} by {inputs})"

    @property
    def system(self) -> System:
        """The system that moves."""
        return self.scene.system

    @property
    def t(self) -> Array:
        """Times of the outputs, (T,) [s]."""
        return self.propagator.plan.scene.report_times

    def __call__(self, **inputs: Any) -> State | ShapeState:
        """Compute the state at the end, or the states at the report times.

        An InputError is raised for invalid inputs, and an IntegrationError as in `simulate`.

        Args:
            **inputs: Values of inputs by name.
        Returns:
            The states, without the base if the scene leaves it out.
        """
        run = self.run(inputs)
        return self.propagator.states(run) if self.over_times else self.propagator.end(run)

    def jvp(self, along: Mapping[str, Any], /, **inputs: Any) -> Array:
        """Compute the derivative of the outputs along directions of inputs.

        Args:
            along: Directions by the name of the input; zero for inputs that are omitted.
            **inputs: Values of inputs by name.
        Returns:
            (rows,), or (T, rows) for a flow over times.
        """
        self._expect_along(1)
        run = self.run(inputs)
        state, constants = self.input_map.directions(along, run.given)
        return self._shaped(self.propagator.along(run, self._rows, state, constants)[..., 0])

    def jacobian(self, **inputs: Any) -> dict[str, Array]:
        """Compute the derivatives of the outputs with respect to each input.

        Args:
            **inputs: Values of inputs by name.
        Returns:
            (…, rows, size) by input, with times first for a flow over times.  There is no
            last axis for parameters that are one number.
        """
        self._expect_along(sum(self.inputs.values()))
        run = self.run(inputs)
        slopes = self.propagator.along(run, self._rows, *self.input_map.basis(run.given))
        return {
            name: self._shaped(columns) for name, columns in self.input_map.by_name(slopes).items()
        }

    def vjp(self, covector: Any, /, **inputs: Any) -> dict[str, Array]:
        """Compute the derivatives of covector · outputs with respect to each input.

        Args:
            covector: Weights of the outputs, (…, rows); or {output: weights (…, its rows)}, with
                zero for omitted outputs.
            **inputs: Values of inputs by name.
        Returns:
            (size,) by input; a number for parameters that are one number.
        """
        self._expect_back()
        run = self.run(inputs, stages=True)
        by_state, by_constants = self.propagator.back(run, self._rows, self._covectors(covector))
        state, constants = self.input_map.basis(run.given)
        return self.input_map.by_name(by_state @ state + by_constants @ constants)

    def explain(self) -> str:
        """Describe the skipped terms, the integrated variables and the inputs, one per line."""
        from ..simulate import integrated, seen_and_integrated, skipped, varying

        plan = self.propagator.plan
        zero = self.propagator.zero_momentum
        lines = [f"skipped: {line}" for line in skipped(plan, zero_momentum=zero)]
        lines += [f"integrated: {integrated(plan)}", *seen_and_integrated(plan)]
        lines += varying(plan, generic=True)
        return "\n".join([*lines, f"method: {plan.method.name} ({plan.choice.why})"])

    def own(self, name: str) -> Array:
        """Return the value of an input in the scene.

        Args:
            name: Name of the input.
        Returns:
            (size,).
        Raises:
            InputError: The flow has no such input.
        """
        names = self.input_map.known
        if name not in names:
            raise InputError(
                f"name: there is no input {quoted(name)}; {nearest(name, names)}the inputs are "
                f"{listed(names, 60)}"
            )
        return self.input_map.value(name)

    def step(self, h: float) -> StepMap:
        """Return one step as a map with Jacobians, for shooting solvers.

        The map takes a State and values of the flow's parameters, and has derivatives with respect
        to both.

        Args:
            h: Length of the step [s].
        Returns:
            The map.
        """
        return StepMap(self, h)

    def one_step(
        self, inputs: Mapping[str, Any], h: float, t: float, *, derivatives: bool
    ) -> tuple[State | ShapeState, Array]:
        """Compute one step of the integrator; see `step`.

        Args:
            inputs: Values of inputs by name, with the state at the start of the step.
            h: Length of the step [s].
            t: Start time of the step [s].
            derivatives: Whether to compute derivatives.
        Returns:
            The state after the step, and the derivatives of the outputs, (rows, N).
        """
        columns_of_inputs = self.input_map.given(inputs)
        columns = self.input_map.basis(columns_of_inputs) if derivatives else None
        return self.propagator.one_step(columns_of_inputs, h, t, self._rows, columns)

    def columns(self) -> Columns:
        """Return the flow as a function between vectors, in the order of `inputs`."""
        from .flow_columns import Columns

        return Columns(self, self.propagator, self.input_map, self.run)

    def casadi(self, name: str = "flow") -> FlowCallback:
        """Return the flow as a CasADi Callback with derivatives; see `columns`.

        The Callback must stay referenced as long as expressions use it.

        Args:
            name: Name of the Callback.
        Returns:
            The Callback.
        Raises:
            InputError: CasADi rejects the name.
        """
        import casadi as ca

        from .flow_columns import FlowCallback

        if not (name.isascii() and ca.Function.check_name(name)):
            raise InputError(
                f"name: expected letters, digits and single underscores that begin with a letter, "
                f"got {quoted(name)}"
            )
        return FlowCallback(self.columns(), name)

    def jax(self) -> Callable[..., Any]:
        """Return the flow as a JAX function with derivatives; see `columns`."""
        from .jax_adapter import jax_function

        return jax_function(self.columns())

    def torch(self) -> Callable[..., Any]:
        """Return the flow as a PyTorch function with autograd; see `columns`."""
        from .torch_adapter import torch_function

        return torch_function(self.columns())

    def run(self, inputs: Mapping[str, Any], *, stages: bool = False) -> Run:
        """Integrate the flow; reuse the last integration if the inputs are the same.

        Args:
            inputs: Values of inputs by name.
            stages: Whether to store stage derivatives for the backward pass.
        Returns:
            The run, with a solution between each two stops.
        """
        from .run_and_adjoint import refuse_singular_run

        columns = self.input_map.given(inputs)
        key = columns.state.tobytes() + columns.constants.tobytes()
        last_run = self._last
        if last_run is None or last_run[0] != key:
            last_run = self._last = (key, self.propagator.run(columns, stages=stages))
            refuse_singular_run(last_run[1])
        return last_run[1]

    def _expect_along(self, count: int) -> None:
        """Let other threads generate the machine code of derivatives along directions, once."""
        from .propagator import expect_along

        once(self, (expect_along, count), lambda: expect_along(self.propagator, self._rows, count))

    def _expect_back(self) -> None:
        """Let other threads generate the machine code of derivatives of a covector, once."""
        from .propagator import expect_back

        once(self, expect_back, lambda: expect_back(self.propagator, self._rows))

    def _covectors(self, covector: Any) -> Array:
        """Return a covector as (T, rows)."""
        shape = (len(self.t), self._size) if self.over_times else (self._size,)
        if isinstance(covector, Mapping):
            weights = np.zeros(shape)
            for name, weights_of_output in covector.items():
                if name not in self.outputs:
                    raise InputError(
                        f"no output {brief(name)}; the outputs are {', '.join(self.outputs)}"
                    )
                place = self.outputs[name]
                expected = (*shape[:-1], place.stop - place.start)
                values = as_floats(weights_of_output, f"the covector of {name}")
                if values.shape != expected:
                    raise ShapeError(
                        f"the covector of {name} must have shape {expected}, got {values.shape}"
                    )
                weights[..., place] = values
            covector = weights
        weights = np.array(as_floats(covector, "the covector"), order="C")
        if weights.shape != shape:
            raise ShapeError(f"the covector must have shape {shape}, got {weights.shape}")
        if not np.isfinite(weights).all():
            raise ShapeError(f"the covector must be finite, got {brief(covector)}")
        return weights.reshape(-1, shape[-1])

    def _shaped(self, rows: Array) -> Array:
        return rows if self.over_times else rows[-1]


@checks_arguments
@shows_fields(Scene)
def flow(
    scene: System | Scene,
    *,
    wrt: Sequence[str] = (),
    of: Sequence[Outcome] | None = None,
    **options: Unpack[SceneOptions],
) -> Flow:
    """Return the flow of a scene as a prepared map with derivatives.

    The flow returns the state at the end, or at `times` if the scene has them.  An InputError is
    raised for scenes without derivatives: with Controllers, which are Python functions, or with
    methods other than DOP853, Tsit5, Gauss and AdaptiveGauss.  A flow detects no events;
    docs/flow.md shows how to get derivatives at a terminal event.  Impacts at joint stops have
    derivatives; docs/stops.md lists where they are refused.

    Args:
        scene: A System, or a Scene whose options apply unless `options` replaces them.
        wrt: Names of the inputs with derivatives.
        of: Names of the outputs with derivatives, fields of State other than t, q and v; x, xdot,
            pose and xi if None.
        options: Fields of Scene.
    Returns:
        The flow.
    """
    resolved = as_scene(scene, options, "flow")
    resolved = with_varied(resolved, wrt)
    if notice := free_joints_notice(resolved):
        warnings.warn(notice, SceneWarning, stacklevel=3)
    return Flow(resolved, wrt, of, over_times=resolved.times is not None)


def _stays_zero(scene: Scene, wrt: Sequence[str]) -> bool:
    """Return whether the momentum is zero for all values of the inputs with derivatives."""
    mu = scene.given.mu
    return motion_of(scene) == "mu" and mu is not None and not mu.any() and "momentum" not in wrt


def _checked_rows(of: Sequence[Outcome] | None, *, wanted: bool) -> tuple[Outcome, ...]:
    outcomes = [name for name in _ROWS if wanted or not FIELDS[name].needs_base]
    if of is None:
        return _ALL if wanted else _SHAPE
    requested: tuple[Any, ...] = (of,) if isinstance(of, str) else tuple(of)
    for outcome in requested:
        if outcome not in outcomes or requested.count(outcome) > 1:
            raise InputError(
                f"the outputs of a flow must be among {', '.join(outcomes)}, each once, "
                f"got {brief(of)}"
            )
    return requested


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

    def __init__(self, flow: Flow, h: float) -> None:
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
        self._flow = Flow(complete, [*STATE, *names], tuple(STATE.values()), over_times=True)
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
