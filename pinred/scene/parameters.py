"""Parameters of a scene: validation of robot parameters together with force parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..common.arrays import Array, as_floats, read_only, vector
from ..common.errors import InputError
from ..common.names import brief, listed
from ..common.parameter import Parameter, VectorParameter, refuse_entry
from ..system.model_parameters import ModelParameters, joined, kinds_near, plain_value, requested
from ..system.system import System, nominal


@dataclass(frozen=True, eq=False)
class GivenParameters:
    """The option `parameters` of a scene, joined with the parameters that its system has.

    Attributes:
        values: {name: value} as stated in the option.
        requested: Names of Parameters in forces that the option lists without values.
        varied: The robot parameters in the option; None if there are none.
        numbers: {name: values} of the robot parameters, as arrays.
        system: The robot with these parameters.
    """

    values: Mapping[str, Any]
    requested: Sequence[str]
    varied: ModelParameters | None
    numbers: Mapping[str, Array]
    system: System

    def checked(self, known: Mapping[str, Parameter | VectorParameter]) -> dict[str, Any]:
        """Return all parameters as numbers and arrays.

        Args:
            known: The Parameters in forces and events, by name.
        Returns:
            {name: number or array}.
        Raises:
            InputError: a name is unknown, or belongs to both the robot and a force.
            ShapeError: a value has the wrong shape.
        """
        parameters: dict[str, Any] = {}
        for name, value in self.values.items():
            if name in self.numbers:
                if name in known:
                    raise InputError(
                        f"parameters: '{name}' is a robot parameter and also the name of a "
                        "Parameter in forces. Rename the Parameter."
                    )
                parameters[name] = plain_value(self.numbers[name])
                continue
            self._check(name, known)
            what, parameter = f"parameters['{name}']", known[name]
            if isinstance(parameter, VectorParameter):
                parameters[name] = read_only(vector(value, len(parameter), what).copy())
                continue
            number = np.ravel(as_floats(value, what))
            parameters[name] = float(vector(number, 1, what)[0])
        for name in self.requested:
            self._check(name, known)
        return parameters

    def _check(self, name: object, known: Mapping[str, Parameter | VectorParameter]) -> None:
        if name not in known:
            refuse_entry(name, known, "parameters")
            names = list(known)
            raise InputError(
                f"parameters: there is no {brief(name)}; {kinds_near(self.system, name, names)}; "
                f"the Parameters in forces and signals here are {listed(names, 60) or 'none'}"
            )


def given_parameters(system: System, parameters: Any) -> GivenParameters:
    """Join the option `parameters` of a scene with the parameters that its system has.

    A parameter of the system keeps its value unless the option has another value.

    Args:
        system: The robot.
        parameters: {name: value}, names, or "all" (see Scene).
    Returns:
        The parameters, and the robot with their values.
    Raises:
        InputError: a link or joint is unknown, a value is not physical, or two names set
            the same property.
    """
    original, present = nominal(system), system.parameters
    values, others = requested(original, parameters)
    if isinstance(parameters, Mapping):
        values = joined(present, values)
    else:  # Names without values keep the values that the system has.
        values |= present
    varied = ModelParameters(original, list(values))
    numbers = varied.checked(values)
    return GivenParameters(
        values, others, varied if varied.names else None, numbers, varied.system(numbers)
    )
