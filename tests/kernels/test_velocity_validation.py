"""Tests that the velocities of all joints are compared separately, at three states."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from coupled_trees import make_case
from faulty_kernels import Faulty, light_tree

import pinred
from pinred.common.arrays import Array
from pinred.kernels.validation import require_agreement, validate_kernel
from pinred.simulation.compiled.compiled_flow import kernel_of
from pinred.simulation.plan import plan_of


@pytest.mark.parametrize("joint", [-1, -2])
def test_validation_detects_wrong_velocity_of_each_joint(joint: int) -> None:
    """The reported Pinocchio velocity of a light joint is compared, too."""
    kernel = light_tree(1e-3)
    validate_kernel(kernel)
    where = kernel.where.fields["v"]
    first, last = where.stop + joint, where.stop + joint + 1
    with pytest.raises(pinred.KernelMismatch, match="Pinocchio: full velocity is"):
        validate_kernel(Faulty(kernel, "out", first, last, 1e-8))  # type: ignore[arg-type]


def test_validation_detects_wrong_velocity_of_followers() -> None:
    """Velocities of mimic joints are compared with the shape rates they follow from."""
    system = make_case("SE3", 5, 0).system
    scene = pinred.Scene(system=system, seed=0)
    kernel = kernel_of(plan_of(scene), zero_momentum=False)
    validate_kernel(kernel)
    where, found = kernel.where.fields["v"], []
    for k in range(where.start, where.stop):
        with pytest.raises(pinred.KernelMismatch) as told:
            validate_kernel(Faulty(kernel, "out", k, k + 1, 1e-8))  # type: ignore[arg-type]
        found.append("velocity of all joints is" in str(told.value))
    assert sum(found) == len(system.followers)


@pytest.mark.parametrize("where", ["out", "rate"])
def test_require_agreement_rejects_nan(where: str) -> None:
    """NaN is rejected among computed and among expected values."""
    with pytest.raises(pinred.KernelMismatch):
        validate_kernel(Faulty(light_tree(1.0), where, 0, 1, np.nan))  # type: ignore[arg-type]
    for pair in ([np.nan, 1.0], [1.0, np.nan]):
        found, expected = np.array([pair]).T
        with pytest.raises(pinred.KernelMismatch, match="it disagrees with Pinocchio: this is off"):
            require_agreement("it", "this", found, expected, 1.0)
    require_agreement("it", "this", np.array([1.0 + 0.9e-10]), np.array([1.0]), 0.0)


def test_validation_compares_three_states() -> None:
    """A fault that is hidden at one state may show at another."""
    kernel, calls = light_tree(1.0), []

    class Counting(Faulty):
        def evaluate_rate(self, *arguments: Any) -> Array:
            calls.append(arguments)
            return kernel.evaluate_rate(*arguments)

    validate_kernel(Counting(kernel, "", 0, 0, 0.0))  # type: ignore[arg-type]
    assert len(calls) == 3
