"""Parameters of a scene: numbers of the robot, and of the forces, by name, checked together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..common.arrays import Array, as_floats, vector
from ..common.errors import InputError
from ..common.plain_names import brief, listed
from ..system.model_parameters import ModelParameters, joined, kinds_near, plain_value, requested
from ..system.system import System
from ..system.variants import nominal


@dataclass(frozen=True, eq=False)
class GivenParameters:
    """The parameters that a scene is given, with those that its system has already.

    values: {name: value} as given.  requested: names without values, of Parameters in forces.
    varied: the numbers of the robot among them, None if there are none.  numbers: their values.
    system: the robot with these.
    """

    values: Mapping[str, Any]
    requested: Sequence[str]
    varied: ModelParameters | None
    numbers: Mapping[str, Array]
    system: System

    def checked(self, known: Sequence[str]) -> dict[str, Any]:
        """Return all as numbers and arrays.  known: names of Parameters in forces and events.

        Raises InputError for names that nothing has, or two things have.
        """
        out: dict[str, Any] = {}
        for name, value in self.values.items():
            if name in self.numbers:
                if name in known:
                    raise InputError(
                        f"parameters: '{name}' is a number of the robot, and a Parameter of the "
                        "forces has the same name; give that another"
                    )
                out[name] = plain_value(self.numbers[name])
                continue
            self._check(name, known)
            given = np.ravel(as_floats(value, f"parameters['{name}']"))
            out[name] = float(vector(given, 1, f"parameters['{name}']")[0])
        for name in self.requested:
            self._check(name, known)
        return out

    def _check(self, name: object, known: Sequence[str]) -> None:
        if name not in known:
            raise InputError(
                f"parameters: there is no {brief(name)}; {kinds_near(self.system, name, known)}; "
                f"the Parameters in forces and signals here are {listed(known, 60) or 'none'}"
            )


def given_parameters(system: System, parameters: Any) -> GivenParameters:
    """Return what a system and the `parameters` of a scene say together.

    What a system has stays, unless it is given anew.  Raises InputError for bodies and joints that
    are not there, for values that no real robot has, and for two names of one thing.
    """
    own, already = nominal(system), system.parameters
    values, others = requested(own, parameters)
    if isinstance(parameters, Mapping):
        values = joined(already, values)
    else:  # names alone, of numbers that stay as they are
        values |= already
    varied = ModelParameters(own, list(values))
    numbers = varied.checked(values)
    return GivenParameters(
        values, others, varied if varied.names else None, numbers, varied.system(numbers)
    )
