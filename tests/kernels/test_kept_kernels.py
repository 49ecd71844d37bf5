"""A System keeps the most recent kernels; others live as long as something uses them."""

from __future__ import annotations

import gc
from pathlib import Path
from weakref import ref

import numpy as np
import pytest

import pinred
from pinred.kernels.kernel import Kernel
from pinred.simulation.compiled import compiled_flow

FUNCTIONS = ("sin", "cos", "tanh", "exp")


def formula(number: int) -> str:
    """Return a function of time; no two numbers give the same expression graph."""
    text, number = "t", number + len(FUNCTIONS)
    while number:
        number, digit = divmod(number, len(FUNCTIONS))
        text = f"{FUNCTIONS[digit]}({text})"
    return text


def run(system: pinred.System, number: int) -> pinred.Trajectory:
    """Simulate a robot under a torque with the formula of a number."""
    torque = pinred.forces.Torque({"bend": pinred.signals.Expression(formula(number))})
    return pinred.simulate(system, duration=0.02, seed=1, forces=[torque])


def executable_maps() -> int:
    """Return the number of executable memory maps of this process."""
    lines = Path("/proc/self/maps").read_text().splitlines()
    return sum("x" in line.split()[1] for line in lines)


def maps_after(system: pinred.System, count: int) -> int:
    """Return the number of executable maps that a number of formulas adds."""
    run(system, 0)
    before = executable_maps()
    for number in range(1, count):
        run(system, number)
    return executable_maps() - before


@pytest.fixture
def built(monkeypatch: pytest.MonkeyPatch) -> list[ref[Kernel]]:
    """Return a list of weak references to all kernels that are built, of which two are kept."""
    kernels: list[ref[Kernel]] = []
    build = vars(compiled_flow)["build_kernel"]

    def record(*arguments: object) -> Kernel:
        kernel: Kernel = build(*arguments)
        kernels.append(ref(kernel))
        return kernel

    monkeypatch.setattr(compiled_flow, "build_kernel", record)
    monkeypatch.setattr(compiled_flow, "MOST_KERNELS", 2)
    return kernels


def test_kernels_beyond_the_limit_are_deleted(built: list[ref[Kernel]]) -> None:
    """Without waiting for Python's garbage collection; their machine code is deleted with them."""
    system = pinred.load("falling_cat")
    gc.disable()
    try:
        added = maps_after(system, 5)
    finally:
        gc.enable()
    assert len(built) == 5
    assert [kernel() is not None for kernel in built] == [False] * 3 + [True] * 2
    if Path("/proc/self/maps").exists():
        assert added <= 4  # one for each kernel, and one for each kernel under construction


def test_trajectory_keeps_its_dropped_kernel(built: list[ref[Kernel]]) -> None:
    """It is evaluated as before, and running the same scene again gives the same."""
    system = pinred.load("falling_cat")
    traj = run(system, 0)
    early = traj(0.0137).x.copy()
    for number in range(1, 4):
        run(system, number)
    gc.collect()
    assert built[0]() is not None
    np.testing.assert_array_equal(traj(0.0137).x, early)
    again = run(system, 0)
    assert len(built) == 5  # built once more
    for name in ("x", "xdot", "pose", "energy"):
        np.testing.assert_array_equal(getattr(again, name), getattr(traj, name))
    del traj
    gc.collect()
    assert built[0]() is None


def test_kernel_in_use_is_not_built_again(built: list[ref[Kernel]]) -> None:
    """The least recently used kernel is dropped, not the oldest."""
    system = pinred.load("falling_cat")
    for number in (0, 1, 0, 2, 0, 1):
        run(system, number)
    assert len(built) == 4


@pytest.mark.by_hand
def test_a_thousand_formulas_add_few_memory_maps() -> None:
    """Each formula added two executable maps for good."""
    assert maps_after(pinred.load("falling_cat"), 1000) < 50
