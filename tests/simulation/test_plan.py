"""The plan of a scene is made once, and describes the integrated variables."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import groups, seeds
from trees import random_model

import pinred
from pinred import DOP853, Gauss, Radau, Variational
from pinred.forces import Damper, Torque, Wrench
from pinred.signals import Hold
from pinred.simulation import plan
from pinred.simulation.compiled.compiled_flow import CompiledFlow
from pinred.simulation.plan import plan_of
from pinred.simulation.simulate import explain_plan

AUTO: Any = "auto"
METHODS = [AUTO, DOP853(1e-9, 1e-11), Gauss(0.01), Radau(1e-9, 1e-11), Variational(0.01)]


@pytest.mark.slow
@settings(max_examples=8)
@given(
    groups,
    st.integers(0, 3),
    seeds,
    st.sampled_from(METHODS),
    st.sampled_from(["all", "shape"]),
    st.booleans(),
)
def test_explained_size_is_that_of_the_flow(
    group: str, joints: int, seed: int, method: Any, outputs: Any, still: bool
) -> None:
    """For any group, integrator and outputs, with and without momentum."""
    system = pinred.load(random_model(group, joints, seed))
    start: dict[str, Any] = {"momentum": 0} if still else {"xi0": np.ones(system.r)}
    scene = pinred.Scene(system=system, method=method, outputs=outputs, duration=0.1, **start)
    found = plan_of(scene)
    size = CompiledFlow.of_plan(found).y0.size
    full = system.model.nq + system.n
    assert f"integrated: {full} → {size} numbers" in explain_plan(found).splitlines()


@pytest.mark.parametrize("method", [Gauss(0.01), Variational(0.01)])
def test_symplectic_method_integrates_a_quaternion(method: Any) -> None:
    """A symplectic method integrates a quaternion instead of three momenta."""
    system = pinred.load("falling_cat")
    options: dict[str, Any] = {"xi0": np.ones(6), "outputs": "shape"}
    for each, size in ((method, 10), (AUTO, 9)):
        lines = explain_plan(plan_of(pinred.Scene(system=system, method=each, **options)))
        assert f"integrated: 19 → {size} numbers" in lines


def test_plan_is_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A scene is resolved once for all its users."""
    counted: Counter[str] = Counter()

    def counting(name: str) -> Any:
        function = getattr(plan, name)

        def call(*args: Any, **options: Any) -> Any:
            counted[name] += 1
            return function(*args, **options)

        return call

    for name in ("choose", "stops_of", "cyclic_of", "acting_gravity", "layout_of"):
        monkeypatch.setattr(plan, name, counting(name))
    system = pinred.load("satellite_two_arms")
    joint = system.shape_names[0]
    forces = [Damper(joint, 0.1), Torque({joint: Hold([0.0, 0.5], [0.1, -0.1])})]
    scene = pinred.Scene(system=system, seed=1, duration=1.0, forces=forces)
    traj = pinred.simulate(scene, explain=True)
    assert traj.energy_balance.residual.shape == traj.momentum_balance.residual.shape[:1]
    assert traj.plan is plan_of(scene)
    assert len(traj.plan.stops) == 2
    assert set(counted.values()) == {1}, counted


def test_fields_of_plan_with_plan_wheel_and_wrench() -> None:
    """The scene has a prescribed joint, a cyclic wheel and a wrench."""
    system = pinred.load("reaction_wheel_satellite")
    assert plan_of(pinred.Scene(system=system, seed=0)).cyclic == (1, 2, 3)
    prescribed = {"wheel_x": pinred.signals.Fourier(0.0, [0.1], [0.0], 1.0)}
    scene = pinred.Scene(
        system=system, seed=0, prescribed=prescribed, forces=[Wrench([0, 0, 0, 0, 0, 1])]
    )
    found = plan_of(scene)
    assert found.driven == (1,)
    assert found.free == tuple(k for k in range(system.m) if k != 1)
    assert found.cyclic == (2, 3)
    assert found.momentum_changes
    assert found.wrench
    assert not found.turned
    assert found.structure(zero_momentum=True) is found.structure(zero_momentum=False)
    assert not found.stops.flags.writeable


def test_plan_of_asymmetric_gravity_raises() -> None:
    """There is no plan if gravity breaks the symmetry."""
    system = pinred.load("double_spherical_pendulum", gravity=[0.0, 9.81, 0.0])
    with pytest.raises(pinred.SymmetryError):
        plan_of(pinred.Scene(system=system, seed=0))


def test_pinocchio_engine_chooses_no_method(monkeypatch: pytest.MonkeyPatch) -> None:
    """The choice of a method is computed at first access."""
    monkeypatch.setattr(plan, "choose", lambda *_: pytest.fail("nobody asked"))
    traj = pinred.simulate(pinred.load("elroys_beanie"), duration=0.1, engine="pinocchio")
    assert traj.run.method == "DOP853"
