"""Run the examples of docs/extending.md and compare their results with other routes."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import casadi as ca
import numpy as np
import pytest

import pinred
from pinred.forces import Torque
from pinred.laboratory.bench.accuracy import SOLVERS
from pinred.lie import GROUPS

ROOT = Path(__file__).parents[1]
# Names that the examples assume to be defined.
PREAMBLE = """
import numpy as np
import pinocchio as pin
import pinred
from pinred.common.arrays import Array
traj = pinred.simulate(pinred.load("falling_cat"), seed=1, duration=0.5)
"""
DOCUMENT = (ROOT / "docs/extending.md").read_text(encoding="utf-8")


def code_of(section: str) -> list[str]:
    """Return the code blocks of a section, in order."""
    (text,) = re.findall(rf"^## {section}\n(.*?)(?=^## |\Z)", DOCUMENT, re.DOTALL | re.MULTILINE)
    return re.findall(r"```python\n(.*?)```", text, re.DOTALL)


@pytest.fixture
def names(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest
) -> Iterator[dict[str, Any]]:
    """Run the code of a section in an empty folder; return the names that it defines."""
    monkeypatch.chdir(tmp_path)
    before = dict(GROUPS)
    module = ModuleType("example")  # dataclasses look up their module by name
    monkeypatch.setitem(sys.modules, "example", module)
    for block in [PREAMBLE, *code_of(request.param)]:
        exec(compile(block, "docs/extending.md", "exec"), vars(module))
    yield vars(module)
    GROUPS.clear()
    GROUPS.update(before)


def test_sections_of_extending_page_are_tested() -> None:
    """All sections of the page have a test here; the integrator example is on its own page."""
    sections = re.findall(r"^## (.*)$", DOCUMENT, re.MULTILINE)
    assert sections == ["A force", "An integrator", "A group", "A figure", "A benchmark peer"]
    assert [bool(code_of(section)) for section in sections] == [True, False, True, True, True]
    assert "Add an explicit method" in (ROOT / "docs/integrators.md").read_text("utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("names", ["A force"], indirect=True)
def test_force_example_matches_equivalent_torque(names: dict[str, Any]) -> None:
    """The force gives the same motion as an equivalent torque, and its work is balanced."""
    torque = Torque(lambda t, x, xdot, mu: {"bend": -0.3 * ca.fabs(xdot[0]) * xdot[0]})  # noqa: ARG005
    cat, traj = pinred.load("falling_cat"), names["traj"]
    assert cat.shape_names[0] == "bend"
    equivalent = pinred.simulate(cat, seed=1, duration=1.0, forces=[torque])
    np.testing.assert_allclose(traj.x, equivalent.x, rtol=0, atol=1e-9)
    assert np.abs(traj.x - pinred.simulate(cat, seed=1, duration=1.0).x).max() > 1e-3
    assert traj.energy_balance.work[-1, 0] < -1e-3
    assert abs(traj.energy_balance.residual).max() < 1e-8
    with pytest.raises(pinred.InputError, match="no shape joint 'bent'"):
        pinred.simulate(cat, seed=1, forces=[names["QuadraticDrag"]("bent", 0.3)])


@pytest.mark.parametrize("names", ["A group"], indirect=True)
def test_group_example_falls_freely(names: dict[str, Any]) -> None:
    """The system is in free fall along its axis, and its angular momentum is constant."""
    motion = names["motion"]
    assert motion.system.group is names["CYLINDER"]
    t, J = motion.t, motion.spatial_momentum
    np.testing.assert_allclose(J[:, 1], J[0, 1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(J[:, 0], J[0, 0] - 4.0 * 9.81 * t, rtol=0, atol=1e-8)


@pytest.mark.parametrize("names", ["A figure"], indirect=True)
def test_figure_example_plots_rates(names: dict[str, Any], tmp_path: Path) -> None:
    """The figure shows the rates with their joint names, and its file is written."""
    traj, (axes,) = names["traj"], names["rates"](names["traj"]).axes
    for k, name in enumerate(traj.system.shape_names):
        curve = axes.lines[k]
        assert curve.get_label() == name
        np.testing.assert_array_equal(
            np.transpose(curve.get_data()), np.stack([traj.t, traj.xdot[:, k]], axis=1)
        )
    assert (tmp_path / "rates.png").stat().st_size > 1000


@pytest.mark.parametrize("names", ["A benchmark peer"], indirect=True)
def test_peer_example_converges_with_order_one(names: dict[str, Any]) -> None:
    """The error of the peer decreases linearly with its step, and its name is unique."""
    problem, solver = names["problem"], names["EULER"]
    assert solver.name not in {known.name for known in SOLVERS}
    reference = pinred.simulate(problem.scene()).x[-1]
    errors = []
    for step in solver.tolerances:
        prepared = solver.prepare(problem, step)
        errors.append(np.abs(prepared.end(prepared.run()).x - reference).max())
    assert errors[-1] < 0.7 * errors[-2] < 0.7 * 0.7 * errors[-3]
