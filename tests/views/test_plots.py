"""Plots of motions: drawn numbers, labels, units, and errors."""

from __future__ import annotations

from io import BytesIO
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from commands import python
from figures import beanie, drawn, units
from matplotlib.text import Text
from pictures import measured

import pinred
from pinred import plots
from pinred.laboratory.bench.accuracy_record import Point, WorkPrecision


@pytest.fixture(scope="module")
def cat() -> pinred.Trajectory:
    """Simulate the falling cat from its default state."""
    return pinred.simulate(pinred.load("falling_cat"), duration=3.0)


def test_shape_plot_in_closed_form() -> None:
    """One joint: the curve is the harmonic motion, with labels of angle and time."""
    traj, t = beanie()
    figure = plots.shape(traj)
    (axes,) = figure.axes
    found_t, found_x = drawn(axes, "beanie")
    np.testing.assert_array_equal(found_t, t)
    np.testing.assert_allclose(found_x, 0.4 * np.cos(np.sqrt(1.5) * t), atol=1e-8)
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("time [s]", "beanie [rad]")
    assert figure.get_suptitle() == "elroys_beanie: shape"


def test_base_plot_in_closed_form() -> None:
    """θ̇ = (J − I2 ẋ) / (I1 + I2) with J = 1.5, integrated."""
    traj, t = beanie()
    (axes,) = plots.base(traj).axes
    x = 0.4 * np.cos(np.sqrt(1.5) * t)
    np.testing.assert_allclose(drawn(axes, "θ")[1], (1.5 * t - (x - 0.4)) / 3.0, atol=1e-8)
    assert axes.get_ylabel() == "θ: angle [rad]"


def test_shape_plot_has_panels_by_branch() -> None:
    """Every joint is drawn once and is labelled."""
    traj = pinred.simulate(pinred.load("planar_chain5"), duration=0.1)
    assert len(plots.shape(traj).axes) == 1
    pytest.importorskip("example_robot_data")
    solo = pinred.simulate(pinred.load("solo12"), seed=0, duration=0.1, engine="pinocchio")
    figure = plots.shape(solo)
    names = [[str(line.get_label()) for line in axes.lines] for axes in figure.axes]
    limbs = ("FL", "FR", "HL", "HR")
    assert names == [[f"{limb}_{joint}" for joint in ("HAA", "HFE", "KFE")] for limb in limbs]
    talos = plots.shape(
        pinred.simulate(pinred.load("talos"), seed=0, duration=0.1, engine="pinocchio")
    )
    panels = [[str(line.get_label()) for line in axes.lines] for axes in talos.axes]
    assert sorted(name for panel in panels for name in panel) == sorted(
        pinred.load("talos").shape_names
    )
    assert [len(panel) for panel in panels] == [6, 6, 2, 8, 8, 2]
    for axes in talos.axes:
        looks = {(str(line.get_color()), str(line.get_marker())) for line in axes.lines}
        assert len(looks) == len(axes.lines)
    assert len(plots.shape(solo, joints=["HR_KFE", "FL_HAA"]).axes[0].lines) == 2


def test_lines_of_panel_differ_in_dashes_or_marker() -> None:
    """For the largest number of lines in a panel."""
    from pinred.views.motion_source import MOST
    from pinred.views.plots.style import line

    looks = {(str(line(k)["linestyle"]), line(k).get("marker")) for k in range(MOST)}
    assert len(looks) == MOST


LINK = """<link name="{0}"><inertial><mass value="1"/><origin xyz="0.1 0 0"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>"""
JOINT = """<joint name="{0}" type="{1}"><parent link="{2}"/><child link="{3}"/><axis xyz="0 1 0"/>
<limit lower="-9" upper="9" effort="1" velocity="1"/></joint>"""


def test_prismatic_joint_has_panel_in_metres(tmp_path: Path) -> None:
    """Units determine panels."""
    sections = [LINK.format(name) for name in "abc"]
    sections += [
        JOINT.format("slide", "prismatic", "a", "b"),
        JOINT.format("turn", "revolute", "b", "c"),
    ]
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm">{"".join(sections)}</robot>')
    traj = pinred.simulate(pinred.load(path, gravity=(0, 0, 0)), seed=0, duration=0.1)
    assert units(plots.shape(traj)) == ["slide [m]", "turn [rad]"]


def test_base_plot_of_body_in_space(cat: pinred.Trajectory) -> None:
    """Position and quaternion are Pinocchio's, with continuous sign."""
    top, bottom = plots.base(cat).axes
    for k, name in enumerate(("x", "y", "z")):
        np.testing.assert_array_equal(drawn(top, name)[1], cat.q[:, k])
    quaternion = np.stack([drawn(bottom, f"q{name}")[1] for name in "xyzw"])
    np.testing.assert_allclose(np.abs(quaternion.T), np.abs(cat.q[:, 3:7]))
    assert np.abs(np.diff(quaternion)).max() < 0.1
    assert units(plots.base(cat)) == ["position [m]", "quaternion [1]"]


def test_quaternion_curves_are_continuous() -> None:
    """Sign changes of a quaternion do not appear."""
    from pinred.views.plots.time_series import continuous

    angle = np.linspace(0.0, 4.0, 9)
    pose = np.stack([np.sin(angle), 0 * angle, 0 * angle, np.cos(angle)], axis=1)
    flipped = pose * np.where(np.arange(9) % 3 == 2, -1.0, 1.0)[:, None]
    np.testing.assert_array_equal(continuous(flipped), pose)


def test_momentum_plot_equals_pinocchio(cat: pinred.Trajectory) -> None:
    """Components of the centroidal momentum, moved to the origin."""
    figure = plots.momentum(cat)
    linear, angular, drift = figure.axes
    model = cat.system.model
    data = model.createData()
    expected = []
    for q, v in zip(cat.q, cat.v, strict=True):
        pin.ccrba(model, data, q, v)
        moment = data.hg.angular + np.cross(data.com[0], data.hg.linear)
        expected.append(np.append(data.hg.linear, moment))
    for k, name in enumerate(("px", "py", "pz", "Lx", "Ly", "Lz")):
        axes = linear if k < 3 else angular
        np.testing.assert_allclose(drawn(axes, name)[1], np.array(expected)[:, k], atol=1e-12)
    assert units(figure) == ["linear [N·s]", "angular [N·m·s]", "drift [relative]"]
    assert drift.get_yscale() == "log"
    assert np.nanmax(drawn(drift, "linear")[1]) < 1e-13


def test_energy_plot_equals_pinocchio() -> None:
    """The visible drift of a coarse run is that of Pinocchio's energy at q and v."""
    system = pinred.load("falling_cat")
    traj = pinred.simulate(system, duration=3.0, rtol=1e-4, atol=1e-6)
    figure = plots.energy(traj)
    top, bottom = figure.axes
    data = system.model.createData()
    kinetic = np.array(
        [
            pin.computeKineticEnergy(system.model, data, q, v)
            for q, v in zip(traj.q, traj.v, strict=True)
        ]
    )
    np.testing.assert_allclose(drawn(top, "energy")[1], kinetic, rtol=1e-9)
    carried = []
    for q, v in zip(traj.q, traj.v, strict=True):
        pin.ccrba(system.model, data, q, v)
        carried.append(0.5 * data.hg.linear @ data.hg.linear / system.mass)
    expected = np.abs(kinetic - kinetic[0]) / (kinetic - carried).max()
    result = drawn(bottom, "energy")[1]
    np.testing.assert_allclose(result[1:], expected[1:], rtol=1e-6, atol=1e-12)
    assert expected.max() > 1e-8
    assert np.isnan(result[0])  # zero has no place on a logarithmic axis
    assert units(figure) == ["energy [J]", "drift [relative]"]
    limits = top.get_ylim()
    assert limits[1] - limits[0] > 1e-3 * abs(kinetic[0])  # round-off is not blown up


def test_energy_plot_has_work_of_forces() -> None:
    """A damper's work is the lost energy; the rest is the drift."""
    system = pinred.load("elroys_beanie")
    damper = pinred.forces.Damper("beanie", 0.2)
    traj = pinred.simulate(system, x0=[0.0], xdot0=[1.0], forces=[damper], duration=3.0)
    top, bottom = plots.energy(traj).axes
    # M ẍ = −c ẋ with M = 2/3, at zero twist: momentum 1 spins all with energy 1/6.
    lost = 0.5 * (2 / 3) * (np.exp(-0.6 * traj.t) - 1.0)
    (label,) = traj.energy_balance.labels
    np.testing.assert_allclose(drawn(top, f"work of {label}")[1], lost, atol=1e-9)
    assert np.nanmax(drawn(bottom, "energy")[1]) < 1e-8


def test_error_plot_equals_distance_to_closed_form() -> None:
    """For an inaccurate trajectory."""
    system = pinred.load("elroys_beanie")
    options: dict[str, Any] = {"x0": [0.4], "momentum": [1.5], "springs": {"beanie": (1.0, 0.0)}}
    traj = pinred.simulate(system, **options, duration=5.0, rtol=1e-3, atol=1e-5)
    report = pinred.compare(traj)
    figure = plots.error(report)
    (axes,) = figure.axes
    t, result = drawn(axes, "shape [rad | m]")
    expected = np.abs(traj(t).x[:, 0] - 0.4 * np.cos(np.sqrt(1.5) * t))
    np.testing.assert_allclose(result[1:], expected[1:], atol=3e-7)
    assert expected.max() > 3e-6
    assert axes.get_yscale() == "log"
    assert units(figure) == ["error [rad | m]"]
    assert not [line for line in axes.lines if "position" in str(line.get_label())]


def test_names_of_lines_do_not_overlap() -> None:
    """Lines that end at one point have names below each other, in the order of their ends."""
    names = [f"m{k}" for k in range(9)]
    points = tuple(
        Point(name, tolerance, wall=wall + 1e-3 * k, shape=tolerance, rotation=0.0, position=0.0)
        for k, name in enumerate(names)
        for tolerance, wall in ((1e-6, 50.0), (1e-3, 1.0))
    )
    result = WorkPrecision("p", 1, 1.0, 1e-12, dict.fromkeys(names, ""), points)
    figure = plots.work_precision(result)
    figure.canvas.draw()
    (axes,) = figure.axes
    written = [text for text in axes.texts if text.get_text() in names]
    boxes = [Text.get_window_extent(text) for text in written]  # without the lines to them
    assert len(boxes) == len(names)
    assert all(low.y1 < high.y0 for low, high in pairwise(boxes))
    assert all(box.x0 > axes.get_window_extent().x1 for box in boxes)


def test_work_precision_plot_has_measured_points() -> None:
    """Wall time in ms against largest error; failures are omitted."""
    figure = plots.work_precision(measured())
    first = figure.axes[0]
    for name, wall, power in (("fast", 0.1, 0.05), ("slow", 1.0, 0.1)):
        error, work = drawn(first, name)
        np.testing.assert_allclose(np.sort(error), np.logspace(-12, -2, 6))
        np.testing.assert_allclose(work, wall * error**-power)
    assert {(axes.get_xscale(), axes.get_yscale()) for axes in figure.axes} == {("log", "log")}
    assert {axes.get_xlabel() for axes in figure.axes} == {"error [rad | m]"}
    assert units(figure) == ["wall time [ms]"] * 2
    (band,) = [patch for patch in first.patches if patch.get_label() == "not known"]
    assert band.get_extents().transformed(first.transData.inverted()).x1 == pytest.approx(1e-11)
    # A method looks the same in every panel.
    colours = [{line.get_label(): line.get_color() for line in axes.lines} for axes in figure.axes]
    assert colours[1]["slow"] == colours[0]["slow"] != colours[0]["fast"]
    names = {text.get_text(): text.get_color() for text in first.texts}
    assert names == {**colours[0], "not known": "#777777"} | {"fast": "#000000"}
    evaluations = plots.work_precision(measured()[0], against="evaluations")
    error, work = drawn(evaluations.axes[0], "slow")
    np.testing.assert_allclose(work, 100 * error**-0.1)
    assert units(evaluations) == ["evaluations, or Taylor steps [1]"]
    with pytest.raises(pinred.InputError, match="against must be one of wall, evaluations"):
        plots.work_precision(measured(), against="time")  # type: ignore[arg-type]
    with pytest.raises(pinred.InputError, match="takes one or more results"):
        plots.work_precision([])


@pytest.mark.slow
def test_names_are_not_parsed_as_formulas(tmp_path: Path) -> None:
    """Names with $ and names that start with _ are in legends."""
    text = '<robot name="$a_$"><link name="base">{}</link>{}</robot>'
    joints = "".join(
        LINK.format(name) + JOINT.format(f"{name}$^", "revolute", "base", name)
        for name in ("_", "b")
    )
    path = tmp_path / "odd.urdf"
    path.write_text(text.format(LINK.format("x").split(">", 1)[1].rsplit("<", 1)[0], joints))
    traj = pinred.simulate(pinred.load(path, gravity=(0, 0, 0)), seed=0, duration=0.1)
    for category in ("shape", "phase", "curvature", "sphere"):
        figure = pinred.plot(traj, category)
        figure.set_layout_engine("none")
        figure.savefig(BytesIO(), dpi=20)
    legend = plots.shape(traj).axes[0].get_legend()
    assert legend is not None
    assert [entry.get_text().strip() for entry in legend.get_texts()] == ["_$^", "b$^"]


def test_plots_reject_unknown_kinds_options_joints(cat: pinred.Trajectory) -> None:
    """The messages list the valid ones."""
    with pytest.raises(pinred.InputError, match="the kinds are base, branches, curvature, cycles"):
        pinred.plot(cat, "shapes")
    with pytest.raises(pinred.InputError, match="no option 'joint'; its options are joints"):
        pinred.plot(cat, "shape", joint=1)  # type: ignore[call-overload]
    with pytest.raises(pinred.InputError, match="no option 'x'; its options are attitude"):
        pinred.plot(cat, "base", x=1)  # type: ignore[call-overload]
    with pytest.raises(pinred.InputError, match="no joint 'tail'; its joints are bend, sway"):
        pinred.plot(cat, "shape", joints=["tail"])
    with pytest.raises(pinred.InputError, match="joint index 3 is out of range for 3 joints"):
        pinred.plot(cat, "shape", joints=[3])
    with pytest.raises(pinred.InputError, match="distinct joints"):
        pinred.plot(cat, "shape", joints=["bend", 0])
    top = pinred.simulate(pinred.load("rigid_body"), duration=0.1)
    with pytest.raises(pinred.InputError, match="at least 1 joint, but 'rigid_body' has 0"):
        pinred.plot(top, "shape")
    with pytest.raises(pinred.InputError, match="takes a Trajectory"):
        plots.shape(3)  # type: ignore[arg-type]


@pytest.mark.by_hand
@pytest.mark.slow
def test_plots_do_not_touch_pyplot_or_settings() -> None:
    """Neither pyplot nor a GUI is imported; user settings have no effect and stay."""
    code = (
        "import sys, matplotlib, io, pinred\n"
        "matplotlib.rcParams['axes.facecolor'] = 'black'\n"
        "before = matplotlib.rcParams.copy()\n"
        "traj = pinred.simulate(pinred.load('elroys_beanie'), duration=0.1)\n"
        "figure = pinred.plot(traj, 'shape')\n"
        "figure.savefig(io.BytesIO())\n"
        "assert figure._repr_png_()[:4] == b'\\x89PNG'\n"
        "print('matplotlib.pyplot' in sys.modules, matplotlib.rcParams.copy() == before,"
        " figure.axes[0].get_facecolor() == (1, 1, 1, 1),"
        " [m for m in sys.modules if '.backends.backend_' in m])"
    )
    assert python(code) == "False True True ['matplotlib.backends.backend_agg']\n"


@pytest.mark.by_hand
@pytest.mark.slow
def test_missing_matplotlib_is_reported() -> None:
    """The message says how to install it; the rest of pinred works."""
    code = (
        "import sys, pinred\n"
        "sys.modules['matplotlib'] = None\n"
        "traj = pinred.simulate(pinred.load('elroys_beanie'), duration=0.1)\n"
        "try:\n    pinred.plot(traj)\nexcept pinred.MissingPackageError as error:\n    print(error)"
    )
    command = 'pip install "pinred[plots]" (in a checkout: pip install ".[plots]")'
    assert python(code) == f"plots need matplotlib: {command}\n"
