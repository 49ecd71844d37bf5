"""Kernels with a planted fault, to test the validation of kernels."""

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
    """A kernel with a fault in the last of a group of outputs, relative to their largest."""

    def __init__(self, kernel: Kernel, where: str, first: int, last: int, fault: float) -> None:
        """Wrap a kernel.

        Args:
            kernel: The correct kernel.
            where: Faulty function, "out" or "rate".
            first: Index of the first output of the group.
            last: Index after the last output of the group.
            fault: Size of the fault, relative to the largest output of the group.
        """
        self._kernel, self._where, self._fault = kernel, where, fault
        self._numbers = slice(first, last)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._kernel, name)

    def evaluate_outputs(self, *arguments: Any) -> Array:
        """Return the outputs, with the fault if `where` is "out"."""
        return self._spoiled("out", self._kernel.evaluate_outputs(*arguments))

    def evaluate_rate(self, *arguments: Any) -> Array:
        """Return the rate, with the fault if `where` is "rate"."""
        return self._spoiled("rate", self._kernel.evaluate_rate(*arguments))

    def _spoiled(self, where: str, values: Array) -> Array:
        values = values.copy()
        if where == self._where:
            group = values[self._numbers]
            group[-1] += self._fault * max(float(np.abs(group).max()), 1e-3)
        return values


def light_tree(ratio: float, seed: int = 1) -> Kernel:
    """Return the kernel of a floating tree whose last body has its inertia scaled by `ratio`."""
    model = random_model("SE3", 3, seed)
    tip = model.inertias[model.njoints - 1]
    model.inertias[model.njoints - 1] = pin.Inertia(
        ratio * tip.mass, tip.lever, ratio * tip.inertia
    )
    model.armature = np.zeros(model.nv)
    scene = pinred.Scene(system=pinred.load(model), seed=0)
    return kernel_of(plan_of(scene), zero_momentum=False)
