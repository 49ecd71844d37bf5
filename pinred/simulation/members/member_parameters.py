"""Parameters of members: those that differ between members, and the numbers in forces they set."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from ...common.arrays import Array, as_floats, dimensions, vectors
from ...common.errors import InputError, ShapeError
from ...common.names import brief, listed
from ...common.parameter import Parameter, VectorParameter, by_name, refuse_entry, value_in
from ...forces.force_model import ForceModel
from ...scene.scene import Scene
from ...system.model_parameters import kinds_near
from ...system.system import System


def varying_parameters(
    values: Mapping[str, Any], robot: Mapping[str, int], base: System | Scene,
    members: Collection[str],
) -> dict[str, Array]:  # fmt: skip
    """Return the parameters with one value for each member.

    Args:
        values: Values of parameters by name.
        robot: Number of entries of each robot parameter among them.
        base: The System or Scene of the members; its forces tell which parameters are vectors.
        members: Names of parameters that must differ between members.
    Returns:
        Values by name, (N,) or (N, k).
    Raises:
        ShapeError: One of `members` is a vector, but has a single value.
    """
    known = force_parameters(base) if isinstance(base, Scene) else {}
    varying = {}
    for name, value in values.items():
        axes: tuple[int, ...] = (1, 2)
        if name in robot:
            axes = (2,) if robot[name] > 1 else (1,)
        elif isinstance(vector := known.get(name), VectorParameter):
            axes = (2,)
            if name in members and dimensions(value) != 2:
                raise ShapeError(
                    f"members['{name}'] must have shape (N, {len(vector)}), got {np.shape(value)}"
                )
        if dimensions(value) in axes:
            varying[name] = rows_of(value, name)
    return varying


def rows_of(value: Any, name: str) -> Array:
    """Return the values (N,), or (N, k), of a parameter.  Raises ShapeError."""
    rows = as_floats(value, name)
    return vectors(rows, rows.shape[-1], f"parameters['{name}']")


def force_parameters(scene: Scene) -> dict[str, Parameter | VectorParameter]:
    """Return the parameters in forces and signals of a scene, by name."""
    return {} if scene.force_model is None else by_name(scene.force_model.parameters)


def check_varying(
    varying: Mapping[str, Array], scene: Scene, robot: Collection[str],
    states: Sequence[str], options: str,
) -> None:  # fmt: skip
    """Check that parameters can vary in scenes, and the shapes of their values.

    Args:
        varying: Values by name, (N,) or (N, k).
        scene: Scene of the members.
        robot: Names of robot parameters.
        states: Names of the initial states that can vary, for the message.
        options: Description of what can vary, for the message.
    Raises:
        InputError: A name is not that of a parameter.
        ShapeError: A value has the wrong shape.
    """
    known = force_parameters(scene)
    for name, values in varying.items():
        if name in robot:
            continue
        if name not in known:
            refuse_entry(name, known, "members")
            names = list(known)
            raise InputError(
                f"members: {brief(name)} cannot vary in these scenes; "
                f"{kinds_near(scene.system, name, [*states, *names])}; these scenes accept "
                f"{options}: {listed(names, 60) or 'none'}"
            )
        parameter = known[name]
        size = (len(parameter),) if isinstance(parameter, VectorParameter) else ()
        if values.shape[1:] != size:
            expected = ", ".join(["N", *map(str, size)]) + ("" if size else ",")
            hint = " For one value of all members, pass a Scene with it." if size else ""
            raise ShapeError(
                f"parameters['{name}'] must have shape ({expected}) for N members, "
                f"got {values.shape}.{hint}"
            )


def member_numbers(
    model: ForceModel, end: float, varying: Mapping[str, Array], count: int
) -> Array:
    """Return the force parameters of each member, (N, p).

    Args:
        model: Forces of the scene of all members.
        end: End of the simulation [s].
        varying: Values of the parameters in forces that differ between members, (N,) or (N, k).
        count: Number N of members.
    """
    # Compute entry by entry, so that a member's results do not depend on the number of members.
    numbers = np.repeat(model.numbers_from(0.0, end)[None], count, axis=0)
    columns = {name: values.T for name, values in varying.items()}
    for k, parameter in enumerate(model.parameters):
        shifts = value_in(columns, parameter) - parameter.value
        numbers += np.broadcast_to(shifts, count)[:, None] * model.slopes[:, k]
    return numbers
