"""The plan of a scene: made once, and what it tells is what is integrated."""

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
from pinred.simulation.explain import explain
from pinred.simulation.plan import plan_of

AUTO: Any = "auto"
METHODS = [AUTO, DOP853(1e-9, 1e-11), Gauss(0.01), Radau(1e-9, 1e-11), Variational(0.01)]


@pytest.mark.slow
@settings(max_examples=30)
@given(
    groups,
    st.integers(0, 3),
    seeds,
    st.sampled_from(METHODS),
    st.sampled_from(["all", "shape"]),
    st.booleans(),
)
def test_what_is_told_is_integrated(
    group: str, joints: int, seed: int, method: Any, outputs: Any, still: bool
) -> None:
    """Any group, integrator and outputs, with momentum and without: the numbers of the run."""
    system = pinred.load(random_model(group, joints, seed))
    start: dict[str, Any] = {"momentum": 0} if still else {"xi0": np.ones(system.r)}
    scene = pinred.Scene(system=system, method=method, outputs=outputs, duration=0.1, **start)
    found = plan_of(scene)
    size = CompiledFlow.of_plan(found).y0.size
    full = system.model.nq + system.n
    assert f"integrated: {full} → {size} numbers" in explain(found).splitlines()


@pytest.mark.parametrize("method", [Gauss(0.01), Variational(0.01)])
def test_a_quaternion_in_place_of_momenta(method: Any) -> None:
    """Symplectic methods integrate four numbers where others take three, and say so."""
    system = pinred.load("falling_cat")
    options: dict[str, Any] = {"xi0": np.ones(6), "outputs": "shape"}
    for each, size in ((method, 10), (AUTO, 9)):
        lines = explain(plan_of(pinred.Scene(system=system, method=each, **options)))
        assert f"integrated: 19 → {size} numbers" in lines


def test_made_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """A scene is resolved once, however many ask for it."""
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


def test_fields() -> None:
    """What a scene with a plan for a joint, a wheel and a wrench comes to."""
    system = pinred.load("reaction_wheel_satellite")
    assert plan_of(pinred.Scene(system=system, seed=0)).acting.cyclic == (1, 2, 3)
    prescribed = {"wheel_x": pinred.signals.Fourier(0.0, [0.1], [0.0], 1.0)}
    scene = pinred.Scene(
        system=system, seed=0, prescribed=prescribed, forces=[Wrench([0, 0, 0, 0, 0, 1])]
    )
    found = plan_of(scene)
    acting = found.acting
    assert acting.driven == (1,)
    assert acting.free == tuple(k for k in range(system.m) if k != 1)
    assert acting.cyclic == (2, 3)
    assert acting.momentum_changes
    assert acting.wrench
    assert not acting.turned
    assert found.kind(zero_momentum=True) is found.kind(zero_momentum=False)
    assert not found.stops.flags.writeable


def test_gravity_that_breaks_the_symmetry() -> None:
    """There is no plan then."""
    system = pinred.load("double_spherical_pendulum", gravity=[0.0, 9.81, 0.0])
    with pytest.raises(pinred.SymmetryError):
        plan_of(pinred.Scene(system=system, seed=0))


def test_the_choice_is_made_where_it_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """The Pinocchio route chooses no integrator, and pays for no choice."""
    monkeypatch.setattr(plan, "choose", lambda *_: pytest.fail("nobody asked"))
    traj = pinred.simulate(pinred.load("elroys_beanie"), duration=0.1, engine="pinocchio")
    assert traj.run.method == "DOP853"
