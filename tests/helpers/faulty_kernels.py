"""Kernels with a fault in one kind of number, for the judge of kernels to find."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
from trees import random_model

import pinred
from pinred.common.arrays import Array
from pinred.kernels.kernel import Kernel
from pinred.simulation.compiled.compiled_flow import kernel_of
from pinred.simulation.plan import plan_of


class Faulty:
    """A kernel with a fault in the last number of a kind, in parts of the largest of it."""

    def __init__(self, kernel: Kernel, where: str, first: int, last: int, fault: float) -> None:
        """Take the kernel; where: "out" or "rate"; first, last: of the numbers of a kind."""
        self._kernel, self._where, self._fault = kernel, where, fault
        self._numbers = slice(first, last)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._kernel, name)

    def evaluate_outputs(self, *arguments: Any) -> Array:
        """Return the outputs, with the fault if it is there."""
        return self._spoiled("out", self._kernel.evaluate_outputs(*arguments))

    def evaluate_rate(self, *arguments: Any) -> Array:
        """Return the rate, with the fault if it is there."""
        return self._spoiled("rate", self._kernel.evaluate_rate(*arguments))

    def _spoiled(self, where: str, values: Array) -> Array:
        values = values.copy()
        if where == self._where:
            of_kind = values[self._numbers]
            of_kind[-1] += self._fault * max(float(np.abs(of_kind).max()), 1e-3)
        return values


def light_tree(ratio: float) -> Kernel:
    """Return that of a tree on a free base whose last body is lighter by a ratio."""
    model = random_model("SE3", 3, 1)
    light = model.inertias[model.njoints - 1]
    model.inertias[model.njoints - 1] = pin.Inertia(
        ratio * light.mass, light.lever, ratio * light.inertia
    )
    model.armature = np.zeros(model.nv)
    scene = pinred.Scene(system=pinred.load(model), seed=0)
    return kernel_of(plan_of(scene), zero_momentum=False)
