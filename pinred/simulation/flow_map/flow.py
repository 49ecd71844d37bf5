"""flow(): a scene as a map from its initial state and parameters to states, with derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Unpack, get_args

import numpy as np

from ...common.arrays import Array, as_floats
from ...common.errors import InputError, ShapeError
from ...common.names import brief
from ...common.signatures import shows_fields
from ...kernels.flow_functions import sizes_of
from ...scene.scene import Scene
from ...scene.scene_options import SceneOptions
from ...system.state_fields import FIELDS, Outcome, ShapeState, State
from ...system.system import System
from ..plan import plan_of
from ..simulate import as_scene
from .inputs import Inputs, motion_of, with_varied
from .propagator import Propagator, Run

if TYPE_CHECKING:
    from .casadi_adapter import FlowCallback
    from .flow_columns import Columns
    from .step_map import StepMap

_ROWS: tuple[Outcome, ...] = get_args(Outcome)
_ALL: tuple[Outcome, ...] = ("x", "xdot", "pose", "xi")
_SHAPE: tuple[Outcome, ...] = ("x", "xdot")


class Flow:
    """The map of a scene from inputs to states, of the steps that the integrator takes.

    Inputs are x0, xdot0, pose0, xi0 or momentum (the one that the scene gives), and the names of
    Parameters; those that are not given at a call have the scene's values.  Derivatives are those
    of the steps as they are taken: their lengths are constants.  A pose among inputs or outputs is
    differentiated in the body's coordinates of its tangent, g exp(η̂) at η = 0.

    inputs: names of the inputs with derivatives, and how many numbers each has.  outputs: the rows
    of derivatives, by the names of State's fields.  over_times: whether it gives states over the
    scene's times, or that at the end.
    """

    def __init__(
        self, scene: Scene, wrt: Sequence[str], of: Sequence[Outcome] | None, *, over_times: bool
    ) -> None:
        """Prepare the flow.  Raises InputError for scenes or names that it cannot be made of."""
        self.scene = scene
        plan = plan_of(scene)
        self.over_times = over_times
        self.propagator = Propagator(plan, zero_momentum=_stays_zero(scene, wrt))
        kernel = self.propagator.kernel
        self.input_map = Inputs(scene, kernel, plan.acting.gravity, wrt)
        self._rows = _checked_rows(of, wanted=plan.wanted)
        sizes, at = sizes_of(scene.system), 0
        places: dict[str, slice] = {}
        for row in self._rows:
            places[row] = slice(at, at + sizes[row])
            at += sizes[row]
        self.outputs: Mapping[str, slice] = MappingProxyType(places)
        self.inputs: Mapping[str, int] = MappingProxyType(self.input_map.sizes)
        self._size = at
        self._last: tuple[bytes, Run] | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        return _flow_of, (self.scene, self.input_map.names, self._rows, self.over_times)

    def __repr__(self) -> str:
        inputs = ", ".join(f"{name} ({size})" for name, size in self.inputs.items()) or "nothing"
        rows = ", ".join(f"{name} ({p.stop - p.start})" for name, p in self.outputs.items())
        return f"Flow({self.scene.system.name!r}, {self.scene.end:g} s, {rows} by {inputs})"

    @property
    def system(self) -> System:
        """The system that moves."""
        return self.scene.system

    @property
    def t(self) -> Array:
        """The times of the outputs, (T,) [s]."""
        return self.scene.report_times

    def __call__(self, **inputs: Any) -> State | ShapeState:
        """Return the state at the end, or states over the scene's times.

        Raises InputError, and IntegrationError as `simulate` does.
        """
        run = self.run(inputs)
        return self.propagator.states(run) if self.over_times else self.propagator.end(run)

    def jvp(self, along: Mapping[str, Any], /, **inputs: Any) -> Array:
        """Return the derivative of the outputs along directions of inputs, (…, rows).

        along: {input: direction}; zero where nothing is given.  …: the times, of a flow over times.
        """
        run = self.run(inputs)
        state, constants = self.input_map.directions(along, run.given)
        return self._shaped(self.propagator.along(run, self._rows, state, constants)[..., 0])

    def jacobian(self, **inputs: Any) -> dict[str, Array]:
        """Return the derivatives of the outputs by each input, {name: (…, rows, size)}.

        Those by a parameter have no last axis.
        """
        run = self.run(inputs)
        found = self.propagator.along(run, self._rows, *self.input_map.basis(run.given))
        return {name: self._shaped(part) for name, part in self.input_map.by_name(found).items()}

    def vjp(self, covector: Any, /, **inputs: Any) -> dict[str, Array]:
        """Return the derivatives of covector · outputs by each input, {name: (size,)}.

        covector: (…, rows), or {output: (…, its rows)} with zero for the others.  That by a
        parameter is a number.
        """
        run = self.run(inputs, stages=True)
        by_state, by_constants = self.propagator.back(run, self._rows, self._covectors(covector))
        state, constants = self.input_map.basis(run.given)
        return self.input_map.by_name(by_state @ state + by_constants @ constants)

    def explain(self) -> str:
        """Return what the flow skips and integrates, and which numbers are its inputs, as lines."""
        from ..explain import integrated, seen_and_integrated, skipped, varying

        plan = self.propagator.plan
        zero = self.propagator.zero_momentum
        lines = [f"skipped: {line}" for line in skipped(plan, zero_momentum=zero)]
        lines += [f"integrated: {integrated(plan)}", *seen_and_integrated(plan)]
        lines += varying(plan, generic=True)
        return "\n".join([*lines, f"method: {plan.method.name} ({plan.choice.why})"])

    def own(self, name: str) -> Array:
        """Return the scene's value of an input, (size,)."""
        return self.input_map.value(name)

    def step(self, h: float) -> StepMap:
        """Return one step of this length [s] as a map with its Jacobians, for shooting solvers.

        It takes a State and the flow's parameters, by any of which it has derivatives.
        """
        from .step_map import StepMap

        return StepMap(self, h)

    def of_scene(self, scene: Scene, wrt: Sequence[str], of: tuple[Outcome, ...]) -> Flow:
        """Return the flow of another scene, over its times."""
        return Flow(scene, wrt, of, over_times=True)

    def one_step(
        self, inputs: Mapping[str, Any], h: float, t: float, *, derivatives: bool
    ) -> tuple[State | ShapeState, Array]:
        """Return the state after one step from time t [s], and slopes (rows, N)."""
        given = self.input_map.given(inputs)
        columns = self.input_map.basis(given) if derivatives else None
        return self.propagator.one_step(given, h, t, self._rows, columns)

    def columns(self) -> Columns:
        """Return the flow between plain columns of numbers, in the order of `inputs`."""
        from .flow_columns import Columns

        return Columns(self, self.propagator, self.input_map, self.run)

    def casadi(self, name: str = "flow") -> FlowCallback:
        """Return the flow as a CasADi Callback with derivatives; see `columns`.

        The object has to live as long as what is made of it.
        """
        from .casadi_adapter import FlowCallback

        return FlowCallback(self.columns(), name)

    def jax(self) -> Callable[..., Any]:
        """Return the flow as a function of JAX with derivatives; see `columns`."""
        from .jax_adapter import jax_function

        return jax_function(self.columns())

    def torch(self) -> Callable[..., Any]:
        """Return the flow as a function of PyTorch with autograd; see `columns`."""
        from .torch_adapter import torch_function

        return torch_function(self.columns())

    def run(self, inputs: Mapping[str, Any], *, stages: bool = False) -> Run:
        """Return a run with these inputs: the last one, if they are the same.

        stages: whether a new one is to keep those of its steps.
        """
        given = self.input_map.given(inputs)
        key = given.state.tobytes() + given.constants.tobytes()
        last = self._last
        if last is None or last[0] != key:
            last = self._last = (key, self.propagator.run(given, stages=stages))
        return last[1]

    def _covectors(self, covector: Any) -> Array:
        """Return a covector as (T, rows)."""
        shape = (len(self.t), self._size) if self.over_times else (self._size,)
        if isinstance(covector, Mapping):
            whole = np.zeros(shape)
            for name, part in covector.items():
                if name not in self.outputs:
                    raise InputError(
                        f"the flow has no output {brief(name)}; they are {', '.join(self.outputs)}"
                    )
                place = self.outputs[name]
                wanted = (*shape[:-1], place.stop - place.start)
                given = as_floats(part, f"the covector of {name}")
                if given.shape != wanted:
                    raise ShapeError(
                        f"the covector of {name} must have shape {wanted}, got {given.shape}"
                    )
                whole[..., place] = given
            covector = whole
        found = np.array(as_floats(covector, "the covector"), order="C")
        if found.shape != shape:
            raise ShapeError(f"the covector must have shape {shape}, got {found.shape}")
        if not np.isfinite(found).all():
            raise ShapeError(f"the covector must be finite, got {brief(covector)}")
        return found.reshape(-1, shape[-1])

    def _shaped(self, rows: Array) -> Array:
        return rows if self.over_times else rows[-1]


@shows_fields(Scene)
def flow(
    scene: System | Scene,
    *,
    wrt: Sequence[str] = (),
    of: Sequence[Outcome] | None = None,
    **options: Unpack[SceneOptions],
) -> Flow:
    """Return the flow of a scene as a prepared map with derivatives.

    scene, options: as for `simulate`.  The flow gives the state at the end, or at `times`, if the
    scene has them.
    wrt: names of the inputs that are to have derivatives.
    of: the rows of derivatives, names of State's fields other than t, q and v; x, xdot, pose and xi
        if None.

    Raises InputError for scenes that have none: with Controllers, which are functions of Python,
    or with methods other than DOP853, Tsit5, Gauss and AdaptiveGauss.
    """
    made = with_varied(as_scene(scene, options, "flow"), wrt)
    over_times = made.times is not None
    if not over_times:
        made = replace(made, times=np.array([made.end]))
    return Flow(made, wrt, of, over_times=over_times)


def _flow_of(scene: Scene, wrt: Sequence[str], of: Sequence[Outcome], over_times: bool) -> Flow:
    """Return a flow that was pickled: its kernels are found by their keys."""
    return Flow(scene, wrt, of, over_times=over_times)


def _stays_zero(scene: Scene, wrt: Sequence[str]) -> bool:
    """Return whether the momentum is zero whatever the inputs are that the flow varies."""
    mu = scene.given.mu
    return motion_of(scene) == "mu" and mu is not None and not mu.any() and "momentum" not in wrt


def _checked_rows(of: Sequence[Outcome] | None, *, wanted: bool) -> tuple[Outcome, ...]:
    known = [name for name in _ROWS if wanted or not FIELDS[name].needs_base]
    if of is None:
        return _ALL if wanted else _SHAPE
    rows: tuple[Any, ...] = (of,) if isinstance(of, str) else tuple(of)
    for row in rows:
        if row not in known or rows.count(row) > 1:
            raise InputError(
                f"the outputs of a flow must be among {', '.join(known)}, each once, "
                f"got {brief(of)}"
            )
    return rows
