"""Tests of two groups defined here, with joints that pinred has no group for."""

from __future__ import annotations

import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin
import pytest
from trees import ROOTS, random_model

import pinred
from pinred.common.arrays import Array
from pinred.forces import Damper, Force, Spring, Wrench
from pinred.lie import GROUPS, Group
from pinred.scene.scene import ENGINES
from pinred.signals import Fourier


class _Commuting(Group):
    """A commutative group: translations, and a rotation about one of their axes."""

    def identity(self) -> Array:
        return np.zeros(self.size)

    def compose(self, g: Array, h: Array) -> Array:
        return g + h

    def inverse(self, g: Array) -> Array:
        return -g

    def exp(self, xi: Array) -> Array:
        return np.array(xi)

    def log(self, g: Array) -> Array:
        xi = np.array(g)
        xi[..., self.linear :] = np.remainder(xi[..., self.linear :] + np.pi, 2 * np.pi) - np.pi
        return xi

    def Ad(self, g: Array) -> Array:
        return np.broadcast_to(np.eye(self.dim), (*g.shape[:-1], self.dim, self.dim)).copy()

    def ad(self, xi: Array) -> Array:
        return np.zeros((*xi.shape[:-1], self.dim, self.dim))

    def rate(self, g: Array, xi: Array) -> Array:  # noqa: ARG002
        return np.array(xi)

    def matrix(self, g: Array) -> Array:
        return np.asarray(pin.exp6(pin.Motion(self._space(g))).homogeneous)

    def from_matrix(self, matrix: Array) -> Array:
        return np.asarray(pin.log6(matrix).vector[list(self.axes)])

    def _space(self, g: Array) -> Array:
        twist = np.zeros(6)
        twist[list(self.axes)] = g
        return twist


CYLINDER = _Commuting(
    name="C", axes=(2, 5), pose_names=("s", "θ"), root="cylindrical", joints=("PZ+RZ",),
    conserved="momentum along the axis and angular momentum about it",
)  # fmt: skip
SHIFTS = _Commuting(
    name="R3", axes=(0, 1, 2), pose_names=("x", "y", "z"), root="translation",
    joints=("Translation",), conserved="momentum",
)  # fmt: skip


def cylindrical_joint() -> pin.JointModel:
    """Return a slide along z with a hinge about it."""
    joint = pin.JointModelComposite()
    joint.addJoint(pin.JointModelPZ())
    joint.addJoint(pin.JointModelRZ())
    return joint


@pytest.fixture(params=[CYLINDER, SHIFTS], ids=repr)
def system(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> pinred.System:
    """Return a tree on a newly registered group, in free fall along its translations."""
    group = request.param
    monkeypatch.setitem(GROUPS, group.name, group)
    joints = {"C": [lambda _: cylindrical_joint()], "R3": [lambda _: pin.JointModelTranslation()]}
    monkeypatch.setitem(ROOTS, group.name, joints[group.name])
    model = random_model(group.name, 3, 4)
    along = np.array([0.0, 0.0, -5.0]) if group is CYLINDER else np.array([1.0, 2.0, -5.0])
    model.gravity.linear = model.jointPlacements[1].rotation @ along
    tree = pinred.load(model, group=group.name)
    assert tree.group is group
    return tree


@pytest.mark.by_hand
def test_custom_group_motion_agrees_with_aba(system: pinred.System) -> None:
    """Free, forced and with a prescribed joint, by both engines, against Pinocchio's ABA."""
    pose0 = system.group.exp(np.linspace(0.3, -0.9, system.r))
    acting: list[Force] = [Spring("joint1", 2.0, 0.3), Damper("joint2", 0.2)]
    acting.append(Wrench(np.linspace(0.4, -0.3, system.r).tolist()))
    plan = {"joint3": Fourier(0.0, [0.3], [0.1], 2.0)}
    scenes: list[dict[str, Any]] = [{}, {"forces": acting, "prescribed": plan}]
    for options in scenes:
        for engine in ENGINES:
            traj = pinred.simulate(
                system, seed=2, duration=1.0, pose0=pose0, engine=engine, **options
            )
            report = pinred.compare(traj)
            assert report.passed, str(report)
            assert traj.momentum_balance.residual == pytest.approx(0.0, abs=1e-8)


def test_custom_group_reduction_agrees_with_crba(system: pinred.System) -> None:
    """I, A and M are those of CRBA, and the curvature agrees with CasADi's."""
    red, x = pinred.Reduction(system), np.array([0.3, -0.8, 1.1])
    at, field = red.at(x), red.grid(x[None])
    for name in ("mass_matrix", "local_connection", "reduced_metric", "curvature"):
        np.testing.assert_allclose(getattr(field, name)[0], getattr(at, name), atol=1e-12)
    functions = pinred.casadi_functions(system)
    B = np.array(functions.curvature(x)).reshape(system.r, 3, 3)
    np.testing.assert_allclose(B, at.curvature, atol=1e-12)


def test_custom_group_names_appear_in_outputs(system: pinred.System, tmp_path: Path) -> None:
    """Reports, files and plots use the names of the custom group."""
    traj = pinred.simulate(system, seed=2, duration=0.5, times=np.linspace(0.0, 0.5, 6))
    group = system.group
    assert f"{group.name}: conserves {group.conserved}" in str(pinred.inspect(system))
    traj.save(tmp_path / "a.csv")
    head = (tmp_path / "a.csv").read_text("utf-8").splitlines()[0].split(",")
    names = [f"pose.{name}".replace("θ", "theta") for name in group.pose_names]
    assert [name for name in head if name.startswith("pose.")] == names
    traj.save(tmp_path / "a.npz")
    recording = pinred.read_recording(tmp_path / "a.npz")
    np.testing.assert_array_equal(recording.pose, traj.pose)
    figure = pinred.plot(traj, "base")
    drawn = [line.get_label() for axes in figure.axes for line in axes.get_lines()]
    assert drawn == list(group.pose_names)
    pinred.plot(traj, "momentum")
    plt.close("all")
    pinred.save_html(traj, tmp_path / "a.html")


@pytest.mark.parametrize(
    "wrong",
    [
        {"axes": (5, 2)},  # rotations first
        {"axes": (2, 4, 5), "pose_names": ("s", "a", "b")},  # two rotations
        {"pose_names": ("s", "c", "s")},
    ],
)
def test_group_rejects_inconsistent_axes_or_names(wrong: dict[str, Any]) -> None:
    """The constructor rejects unordered axes, two rotations, and wrong numbers of names."""
    with pytest.raises(pinred.InputError, match="C: axes are translations, then"):
        replace(CYLINDER, **wrong)


def test_gravity_across_cylinder_axis_is_rejected(monkeypatch: pytest.MonkeyPatch) -> None:
    """Such gravity rotates the base, and the error names the axis."""
    monkeypatch.setitem(GROUPS, "C", CYLINDER)
    monkeypatch.setitem(ROOTS, "C", [lambda _: cylindrical_joint()])
    model = random_model("C", 1, 4)
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    with pytest.raises(pinred.SymmetryError, match=r"the C symmetry .* its axis"):
        pinred.simulate(pinred.load(model), seed=0, duration=1.0)


def test_group_module_in_lie_folder_is_registered(tmp_path: Path) -> None:
    """A new module in the folder of groups is registered automatically."""
    package = Path(pinred.__file__).parent
    shutil.copytree(package, tmp_path / "pinred", ignore=shutil.ignore_patterns("__pycache__"))
    new = """from dataclasses import replace

from .groups import RxSE2

SE2xR = replace(RxSE2, name="SE2xR")
"""
    (tmp_path / "pinred" / "lie" / "further.py").write_text(new, encoding="utf-8")
    code = "from pinred.lie import GROUPS; print(*GROUPS)"
    ran = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert ran.stdout.split() == ["R", "SO2", "SE2", "SO3", "RxSE2", "SE2xR", "SE3"]
