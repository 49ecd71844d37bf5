"""Velocities of all joints are judged each for itself, at three states."""

from __future__ import annotations

from typing import Any

import pytest
from coupled_trees import make_case
from faulty_kernels import Faulty, light_tree

import pinred
from pinred.common.arrays import Array
from pinred.kernels.judge import judge
from pinred.simulation.compiled.kernel_of_plan import kernel_of
from pinred.simulation.plan import plan_of


@pytest.mark.parametrize("joint", [-1, -2])
def test_each_velocity_is_found(joint: int) -> None:
    """Of a light joint, too, in what is reported as Pinocchio's velocity."""
    kernel = light_tree(1e-3)
    judge(kernel)
    where = kernel.where.v
    first, last = where.stop + joint, where.stop + joint + 1
    with pytest.raises(pinred.KernelMismatch, match="Pinocchio: full velocity is"):
        judge(Faulty(kernel, "out", first, last, 1e-8))  # type: ignore[arg-type]


def test_velocities_of_followers_are_found() -> None:
    """They are reported beside those of the shape, from which they follow."""
    system = make_case("SE3", 5, 0).system
    scene = pinred.Scene(system=system, seed=0)
    kernel = kernel_of(plan_of(scene), zero_momentum=False)
    judge(kernel)
    where, found = kernel.where.v, []
    for k in range(where.start, where.stop):
        with pytest.raises(pinred.KernelMismatch) as told:
            judge(Faulty(kernel, "out", k, k + 1, 1e-8))  # type: ignore[arg-type]
        found.append("velocity of all joints is" in str(told.value))
    assert sum(found) == len(system.followers)


def test_three_states_are_judged() -> None:
    """A fault that one state hides shows at another."""
    kernel, calls = light_tree(1.0), []

    class Counting(Faulty):
        def evaluate_rate(self, *arguments: Any) -> Array:
            calls.append(arguments)
            return kernel.evaluate_rate(*arguments)

    judge(Counting(kernel, "", 0, 0, 0.0))  # type: ignore[arg-type]
    assert len(calls) == 3
