"""Fields over many shapes: compiled code against Pinocchio and against closed forms."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from commands import python
from hypothesis import given, settings
from strategies import Case, cases
from trees import random_model

import pinred
from pinred.analysis.connections import shape_field
from pinred.common.arrays import Array
from pinred.kernels import kernel as kernels
from pinred.kernels.connection.connection_code import ConnectionCode
from pinred.system.find_robot_files import bundled_robots

NAMES = ("mass_matrix", "locked_inertia", "local_connection", "reduced_metric", "curvature", "com")


def close(found: Array, expected: Array, tolerance: float = 1e-11) -> None:
    """Assert the same shape, and agreement to `tolerance` of the largest entry."""
    assert found.shape == expected.shape
    scale = max(1.0, float(np.abs(expected).max(initial=0.0)))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=tolerance * scale)


def agree(red: pinred.Reduction, shapes: Array) -> None:
    """Assert that every array is the one that Pinocchio gives, shape by shape."""
    field = red.grid(shapes)
    lead = shapes.shape[:-1]
    for name in NAMES:
        computed = getattr(field, name)
        assert computed.shape[: len(lead)] == lead
        for index in np.ndindex(lead):
            close(computed[index], getattr(red.at(shapes[index]), name))


# Every run has mass matrices of grids in test_coupled_joints.
@pytest.mark.by_hand
@settings(max_examples=8)
@given(cases(0, 8))
def test_grid_mass_matrix_equals_crba(case: Case) -> None:
    """H at any pose of the base, and its blocks, for trees on every group."""
    system, r = case.system, case.system.r
    shapes = case.rng.uniform(-3.0, 3.0, (4, system.m))
    field = pinred.Reduction(system).grid(shapes)
    data = system.model.createData()
    for k, x in enumerate(shapes):
        upper = np.triu(pin.crba(system.model, data, system.q(case.pose, x)))
        H = upper + np.triu(upper, 1).T
        A = np.linalg.solve(H[:r, :r], H[:r, r:])
        close(field.mass_matrix[k], H, 1e-13)
        close(field.locked_inertia[k], H[:r, :r], 1e-13)
        close(field.local_connection[k], A)
        close(field.reduced_metric[k], H[r:, r:] - H[r:, :r] @ A)


@pytest.mark.by_hand
@settings(max_examples=8)
@given(cases(0, 6))
def test_grid_curvature_equals_rnea_derivatives(case: Case) -> None:
    """B of trees on every group, with any leading axes."""
    red = pinred.Reduction(case.system)
    for lead in ((), (3,), (2, 2)):
        agree(red, case.rng.uniform(-3.0, 3.0, (*lead, case.system.m)))
    B = red.grid(case.x).curvature
    np.testing.assert_array_equal(B, -np.swapaxes(B, 1, 2))


QUICK = ("cartpole", "falling_cat_ball", "reaction_wheel_satellite", "rigid_body", "solo12")
TREES = [name for name, robot in sorted(bundled_robots().items()) if not robot.loops]


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[pytest.mark.by_hand] * (name not in QUICK))
        for name in [*TREES, "solo12", "talos"]
    ],
)
@pytest.mark.sampled(3)
def test_grid_of_robots_equals_pinocchio(name: str) -> None:
    """Bundled robots (cyclic joints, balls, one without joints), a quadruped, a humanoid."""
    if name in ("solo12", "talos"):
        pytest.importorskip("example_robot_data")
    system = pinred.load(name)
    rng = np.random.default_rng(0)
    shapes = np.array([system.space.random(rng, 2.0) for _ in range(3)])
    agree(pinred.Reduction(system), shapes.reshape(3, system.nx))


@pytest.mark.parametrize("name", ["satellite_two_arms", "planar_chain5"])
def test_grid_in_chunks_equals_pinocchio(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Chunks of shapes, the last one smaller, give the values of single shapes."""
    system = pinred.load(name)
    red, rng = pinred.Reduction(system), np.random.default_rng(1)
    shapes = rng.uniform(-2.0, 2.0, (11, system.m))
    monkeypatch.setattr(kernels, "_ENTRIES", 4 * system.m * (1 + system.r * (1 + system.m)))
    agree(red, shapes)


def test_grid_includes_armature_of_root() -> None:
    """A flywheel on the axis of SO(2) is part of the locked inertia."""
    model = random_model("SO2", 3, 7)
    armature = np.array(model.armature)
    armature[0] = 0.8
    model.armature = armature
    system = pinred.load(model)
    x = np.array([0.3, -0.4, 1.1])
    expected = pin.crba(system.model, system.model.createData(), system.q(np.zeros(1), x))[0, 0]
    locked_inertia = pinred.Reduction(system).grid(x).locked_inertia
    np.testing.assert_allclose(locked_inertia, [[expected]], rtol=1e-13)


def two_sliders(spin: float, carriage: float, load: float) -> pinred.System:
    """A turntable on which a carriage slides along x, and on it a load along y."""
    model = pin.Model()
    model.name = "two_sliders"
    model.gravity.setZero()
    parent = 0
    bodies = [
        (pin.JointModelRZ(), 1.0, spin - 0.2),
        (pin.JointModelPX(), carriage, 0.1),
        (pin.JointModelPY(), load, 0.1),
    ]
    for k, (joint, mass, moment) in enumerate(bodies):
        parent = model.addJoint(parent, joint, pin.SE3.Identity(), f"joint{k}")
        inertia = pin.Inertia(mass, np.zeros(3), moment * np.eye(3))
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    return pinred.load(model)


def test_grid_of_sliders_on_turntable_has_closed_form() -> None:
    """I = J + (m1 + m2) s² + m2 u², A = m2 (−u, s)/I, and B = 2 m2 J/I²."""
    J, m1, m2 = 1.5, 2.0, 0.7
    red = pinred.Reduction(two_sliders(J, m1, m2))
    a = np.linspace(-1.0, 1.0, 7)
    shapes = np.stack(np.meshgrid(a, 0.3 + a, indexing="ij"), axis=-1)
    s, u = shapes[..., 0], shapes[..., 1]
    inertia = J + (m1 + m2) * s**2 + m2 * u**2
    field = red.grid(shapes)
    close(field.locked_inertia[..., 0, 0], inertia, 1e-14)
    A = m2 * np.stack([-u, s], axis=-1) / inertia[..., None]
    close(field.local_connection[..., 0, :], A, 1e-14)
    M = np.diag([m1 + m2, m2]) - inertia[..., None, None] * A[..., :, None] * A[..., None, :]
    close(field.reduced_metric, M, 1e-14)
    close(field.curvature[..., 0, 0, 1], 2.0 * m2 * J / inertia**2, 1e-14)


def test_grid_of_coupled_planar_bodies_is_constant() -> None:
    """A cyclic joint: A = (0, −1/30, 4/15) and M = 11/60 at every shape, no curvature."""
    field = pinred.Reduction(pinred.load("coupled_planar")).grid(np.linspace(-3, 3, 9)[:, None])
    ones = np.ones(9)[:, None]
    close(field.local_connection[..., 0], ones * [0.0, -1.0 / 30.0, 4.0 / 15.0], 1e-14)
    close(field.reduced_metric[..., 0], ones * 11.0 / 60.0, 1e-14)
    close(field.curvature, np.zeros((9, 3, 1, 1)), 1e-14)


def test_grid_of_cartpole_has_closed_form() -> None:
    """A = −cos(x)/6, V = −4.905 cos(x), and I = 3 in the amended potential."""
    field = pinred.Reduction(pinred.load("cartpole")).grid(np.linspace(-3, 3, 12).reshape(3, 4, 1))
    cosine = np.cos(field.x[..., 0])
    close(field.local_connection[..., 0, 0], -cosine / 6.0, 1e-14)
    close(field.potential, -4.905 * cosine, 1e-13)
    close(field.amended_potential([1.2]), -4.905 * cosine + 0.24, 1e-13)


@settings(max_examples=8)
@given(cases(0, 6))
def test_grid_potential_equals_pinocchio(case: Case) -> None:
    """Springs, and gravity that keeps the symmetry, against Pinocchio's potential energy."""
    springs = dict.fromkeys(case.system.shape_names[:2], (2.0, 0.3))
    if case.system.group is pinred.lie.R:
        case.system.model.gravity.linear = np.array([0.3, -2.0, -9.0])
    red = pinred.Reduction(case.system, springs=springs)
    shapes = case.rng.uniform(-3.0, 3.0, (2, 3, case.system.m))
    field = red.grid(shapes)
    amended = field.amended_potential(case.xi)
    for index in np.ndindex(2, 3):
        close(field.potential[index], np.array(red.potential(shapes[index])))
        expected = red.amended_potential(shapes[index], case.xi)
        close(amended[index], np.array(expected))


def test_grid_with_broken_symmetry_lacks_potential_only() -> None:
    """Only the potential raises."""
    model = random_model("SO3", 2, 3)
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    field = pinred.Reduction(pinred.load(model)).grid(np.zeros((4, 2)))
    assert field.curvature.shape == (4, 3, 2, 2)
    with pytest.raises(pinred.SymmetryError, match="SO3"):
        _ = field.potential
    with pytest.raises(pinred.SymmetryError, match="SO3"):
        field.amended_potential(np.ones(3))


def test_shape_field_array_is_computed_once_at_first_use(monkeypatch: pytest.MonkeyPatch) -> None:
    """An array does not compute others that it does not need."""
    calls: list[str] = []

    def count(owner: Any, name: str) -> None:
        function = getattr(owner, name)

        def counted(*arguments: Any) -> Any:
            calls.append(name)
            return function(*arguments)

        monkeypatch.setattr(owner, name, counted)

    count(ConnectionCode, "locals")
    count(ConnectionCode, "curvature")
    count(shape_field, "centres_of_mass")
    field = pinred.Reduction(pinred.load("falling_cat")).grid(np.zeros((5, 3)))
    assert calls == []
    for _ in range(2):
        assert field.potential.shape == (5,)
        assert calls == ["centres_of_mass"]
    for _ in range(2):
        for name in ("mass_matrix", "locked_inertia", "local_connection", "reduced_metric"):
            assert getattr(field, name) is not None
        assert calls == ["centres_of_mass", "locals"]
    for _ in range(2):
        assert field.curvature.any()
        assert calls == ["centres_of_mass", "locals", "curvature"]


def test_grid_arrays_are_read_only() -> None:
    """The field does not change with the array from which it was built."""
    shapes = np.zeros((2, 3))
    field = pinred.Reduction(pinred.load("falling_cat")).grid(shapes)
    shapes[:] = 1.0
    assert not field.x.any()
    for name in ("x", *NAMES, "potential"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(field, name)[...] = 0.0
    with pytest.raises(ValueError, match="read-only"):
        field.amended_potential(np.zeros(6))[...] = 0.0
    with pytest.raises(AttributeError):
        field.x = shapes  # type: ignore[misc]


def test_grid_of_no_shapes_is_empty() -> None:
    """An empty field has empty arrays."""
    field = pinred.Reduction(pinred.load("falling_cat")).grid(np.zeros((0, 4, 3)))
    assert field.curvature.shape == (0, 4, 6, 3, 3)
    assert field.reduced_metric.shape == (0, 4, 3, 3)
    assert field.amended_potential(np.ones(6)).shape == (0, 4)


@pytest.mark.parametrize(
    ("shapes", "words"),
    [
        (0.1, r"shape \(\.\.\., 1\) \(hinge\), got \(\)"),
        ([0.1, 0.2], r"shape \(\.\.\., 1\) \(hinge\), got \(2,\)"),
        (np.zeros((3, 1, 2)), r"got \(3, 1, 2\)"),
        ([[0.0], [np.nan], [np.inf]], r"finite.*entry \(1, 0\) \(hinge\) is nan"),
        ([[[0.0], [-np.inf]]], r"finite.*entry \(0, 1, 0\) \(hinge\) is -inf"),
        ([["a"]], "numbers"),
        ([[1j]], "numbers"),
    ],
)
def test_grid_of_invalid_shapes_raises(shapes: Any, words: str) -> None:
    """A wrong length or a number that is not finite raises at once, with its index."""
    with pytest.raises(pinred.ShapeError, match=words):
        pinred.Reduction(pinred.load("coupled_planar")).grid(shapes)


def test_amended_potential_of_many_momenta_raises() -> None:
    """The momentum of the amended potential is one body momentum."""
    field = pinred.Reduction(pinred.load("falling_cat")).grid(np.zeros((2, 3)))
    with pytest.raises(pinred.ShapeError, match=r"mu must have shape \(6,\)"):
        field.amended_potential(np.zeros((2, 6)))


@pytest.mark.parametrize("nearly", [0.0, 2e-8])
def test_grid_names_singular_shape(nearly: float) -> None:
    """Gimbal lock of massless rings, where the outer and inner axes coincide."""
    model, parent = pin.Model(), 0
    model.name = "gimbal"
    model.gravity.setZero()
    for k, joint in enumerate((pin.JointModelRZ(), pin.JointModelRX(), pin.JointModelRZ())):
        parent = model.addJoint(parent, joint, pin.SE3.Identity(), f"ring{k}")
        model.appendBodyToJoint(
            parent, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity()
        )
    system = pinred.load(model)
    for i in (1, 2):  # Set after loading, to bypass its checks.
        system.model.inertias[i] = pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3)))
    red = pinred.Reduction(system)
    assert red.grid([[1.0, 0.3], [2.0, 0.2]]).locked_inertia.shape == (2, 1, 1)
    field = red.grid([[1.0, 0.3], [nearly, 0.2], [2.0, 0.1]])
    for name in ("mass_matrix", "locked_inertia", "curvature"):
        with pytest.raises(pinred.SingularInertiaError, match=re.escape(f"x = {field.x[1]}")):
            getattr(field, name)


@pytest.mark.slow
def test_reduction_at_one_shape_imports_no_compiler() -> None:
    """CasADi, LLVM and numba are imported for fields over many shapes only."""
    code = (
        "import sys, numpy as np, pinred\n"
        "red = pinred.Reduction(pinred.load('falling_cat'))\n"
        "assert red.at(np.zeros(3)).curvature.shape == (6, 3, 3)\n"
        "print(*{'casadi', 'llvmlite', 'numba'} & set(sys.modules))"
    )
    assert python(code).strip() == ""
