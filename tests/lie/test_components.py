"""Components of poses, twists and momenta have all names of one table, wherever they are asked."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinred
from pinred.cli.command_line import main
from pinred.forces import Controller
from pinred.lie.group import Group
from pinred.lie.groups import GROUPS, SE2, SE3, SO2
from pinred.views.plots.connection_field import component_of

SWIMMER = pinred.load("coupled_planar")
# Names of the entries of SE(2) in any quantity.
PLANAR = (("x", "v1"), ("y", "v2"), ("θ", "theta", "turn", "ω", "w", "omega"))


@pytest.mark.parametrize("group", GROUPS.values(), ids=repr)
def test_components_start_with_the_names_of_the_quantity(group: Group) -> None:
    """In order, and every other name means an entry of the same axis."""
    names = {
        "pose": group.pose_names, "twist": group.twist_names, "momentum": group.momentum_names,
    }  # fmt: skip
    for quantity, own in names.items():
        components = group.components(quantity)  # type: ignore[arg-type]
        assert list(components)[: len(own)] == list(own)
        assert set(components.values()) == set(range(len(own)))
    for name, k in group.components("twist").items():
        full = (*(f"v{i}" for i in (1, 2, 3)), *(f"ω{i}" for i in (1, 2, 3)))[group.axes[k]]
        assert group.components("twist")[full] == k, name
        letter = {"x": 0, "y": 1, "z": 2}.get(name)
        assert letter in (None, group.axes[k])


@pytest.mark.parametrize("quantity", ["pose", "twist", "momentum"])
def test_components_of_se2_are_accepted_by_all_names(quantity: str) -> None:
    """Those of a pose for a twist, and the reverse."""
    for k, names in enumerate(PLANAR):
        for name in names:
            assert SE2.components(quantity)[name] == k  # type: ignore[arg-type]
    assert "p1" not in SE2.components("twist")
    assert {"turn", "w1"}.isdisjoint(SE3.components("pose"))
    assert SO2.components("momentum")["L"] == 0
    with pytest.raises(pinred.InputError, match="quantity: expected twist or pose or momentum"):
        SO2.components("speed")  # type: ignore[arg-type]


def test_formula_and_function_name_components() -> None:
    """Events at one time, by number, by each name in a formula, and by name in a function."""
    chain = pinred.load("planar_chain5")
    start: dict[str, Any] = {"seed": 2, "pose0": [0.3, -0.2, 0.9], "duration": 0.4, "rtol": 1e-12}
    state = pinred.simulate(chain, times=[0.0, 0.2, 0.4], **start).states
    pose, xi, J = state.pose[1].tolist(), state.xi[1].tolist(), state.spatial_momentum[1]
    L = float(J[2]) - pose[0] * float(J[1]) + pose[1] * float(J[0])  # about the origin of the base
    events = []
    for k, names in enumerate(PLANAR):
        for name in names:
            events += [
                pinred.Event(f"pose['{name}'] - ({pose[k]!r})", f"pose_{name}"),
                pinred.Event(f"xi['{name}'] - ({xi[k]!r})", f"xi_{name}"),
            ]
            events.append(
                pinred.Event(lambda s, k=k, name=name: s.pose[name] - pose[k], f"seen_{name}")
            )
    events.append(pinred.Event(lambda s: s.mu["L"] - L, "mu_L"))
    traj = pinred.simulate(chain, events=events, **start)
    for name, crossings in traj.events.items():
        assert np.abs(crossings.t - 0.2).min() < 1e-7, name


def test_unknown_component_names_the_components() -> None:
    """In functions, formulas, figures, and sweeps."""
    scene: dict[str, Any] = {"seed": 2, "duration": 0.1}
    with pytest.raises(pinred.InputError, match=r"pose: no component 'z'; .*are x, y, θ"):
        pinred.Scene(system=SWIMMER, events=pinred.Event(lambda s: s.pose["z"]), **scene)
    with pytest.raises(pinred.InputError, match=r"pose has no entry 'z'(.|\n)*pose\['x'\]"):
        pinred.Scene(system=SWIMMER, events=pinred.Event("pose['z'] - 1"), **scene)
    with pytest.raises(pinred.InputError, match=r"component of SE2: no component 'p'.*v1, v2, ω"):
        component_of(SE2, "p", np.ones(3))
    with pytest.raises(pinred.InputError, match="expected an index below 3 or a name, got 3"):
        component_of(SE2, 3, np.ones(3))
    with pytest.raises(pinred.InputError, match=r"vary: there is no 'pose0.zz'; did you mean"):
        pinred.sweep(pinred.Scene(system=SWIMMER, **scene), {"pose0.zz": [1.0]})


def test_controller_reads_components_by_name() -> None:
    """Its arrays have names, and results of arithmetic are plain arrays."""
    seen = []

    def hold(s: pinred.forces.SeenState) -> list[float]:
        same = [s.pose["turn"] == s.pose[2], s.xi["w"] == s.xi[2], s.J["L"] == s.J[2]]
        seen.append((all(same), type(s.pose + 1.0) is np.ndarray, s.mu["p1"] == s.mu[0]))
        return [0.0]

    controller = Controller(hold, period=0.1)
    pinred.simulate(SWIMMER, seed=2, duration=0.3, forces=controller)
    assert len(seen) >= 3
    assert np.all(seen)


def test_field_is_drawn_of_component_by_any_name() -> None:
    """Index, name of the twist and name of the pose select the same entry."""
    for k, names in enumerate(PLANAR):
        asked: tuple[str | int, ...] = (*names, k)
        assert {component_of(SE2, name, np.ones(3)) for name in asked} == {k}
    assert component_of(SE3, "y", np.ones(6)) == 1
    assert component_of(SE3, "w2", np.ones(6)) == 4


def test_sweep_varies_and_stores_components_by_any_name(tmp_path: Path) -> None:
    """Results of two spellings are equal, and one entry cannot be varied twice."""
    scene = pinred.Scene(system=SWIMMER, seed=2, duration=0.2, times=[0.0, 0.2])
    results = [
        pinred.sweep(scene, {f"pose0.{turn}": [0.1, 0.4]}, outputs={"turn": f"pose.{turn}"},
                     store=tmp_path / f"{turn}.zarr")
        for turn in ("θ", "turn")
    ]  # fmt: skip
    for result in results:
        np.testing.assert_array_equal(result["turn"].values, results[0]["turn"].values)
        assert result["turn"].attrs["units"] == "rad"
    with pytest.raises(pinred.InputError, match="are one number"):
        pinred.sweep(scene, {"pose0.θ": [0.1], "pose0.turn": [0.2]})


def test_axis_of_gait_is_a_component(capsys: pytest.CaptureFixture[str]) -> None:
    """`--axis v1` is `--axis x`, and the turn is an axis of planar rotations."""
    words = ["gait", "falling_cat", "--harmonics", "1", "--starts", "1", "--limits", "0.5"]
    texts = []
    for axis in ("x", "w1"):
        assert main([*words, "--axis", axis]) == 0
        texts.append(capsys.readouterr().out)
    assert texts[0].splitlines()[:3] == texts[1].splitlines()[:3]
    assert main([*words, "--axis", "v1"]) == 2
    assert "axis must be x, y, z or a vector, got 'v1'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("robot", "message"),
    [
        ("coupled_planar", "expected 3 numbers: px, py, L, got 2"),
        ("falling_cat", "expected 6 numbers: px, py, pz, Lx, Ly, Lz, got 2"),
        ("rigid_body", "expected 3 numbers: Lx, Ly, Lz, got 2"),
        ("elroys_beanie", "expected 1 number: L, got 2"),
        ("cartpole", "expected 1 number: p, got 2"),
    ],
)
def test_momentum_of_wrong_length_names_its_components(
    robot: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """On the command line, in the notation of each group."""
    assert main(["compare", robot, "--momentum", "1,2"]) == 2
    assert capsys.readouterr().err == f"pinred: error: momentum: {message}\n"
