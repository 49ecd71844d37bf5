"""Tests of identical branches and joined limbs in SIMD lanes, against Pinocchio and NumPy."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import groups, seeds
from trees import inertia, limbed_model, mirrored_model, placement, unequal_limbs_model

import pinred
from pinred.common.arrays import Array
from pinred.common.machine_code import load_object
from pinred.common.object_cache import ObjectCache
from pinred.kernels.build import build_kernel
from pinred.kernels.differentiable import adjoint_in_lanes, tangent_in_lanes
from pinred.kernels.kernel import Structure
from pinred.kernels.machine import native
from pinred.kernels.machine.native import compile_object
from pinred.kernels.reduced_graph import ReducedGraph
from pinred.kernels.reference_state import random_state
from pinred.reduction.tree.body_frames import bodies_of, cosine, sine
from pinred.reduction.tree.identical_branches import Lanes, Mark, links_of
from pinred.reduction.tree.scalars import Turn
from pinred.simulation.compiled.compiled_flow import CompiledFlow
from pinred.simulation.pinocchio_engine import PinocchioFlow
from pinred.simulation.plan import plan_of

MADE = [limbed_model, mirrored_model, unequal_limbs_model]
POINTER = ctypes.POINTER(ctypes.c_double)


@pytest.fixture(autouse=True)
def private_cache(
    tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Use a private folder for the kernels of each test."""
    monkeypatch.setenv("PINRED_CACHE_DIR", str(tmp_path_factory.mktemp("cache", numbered=True)))


def build(lanes: Lanes, x: ca.SX, out: ca.SX) -> Callable[[Array], Array]:
    """Compile an expression with marks."""
    function = lanes.function("f", [x], out)
    code = load_object(compile_object(function, "f", lanes.marks["f"]), "f")
    raw = ctypes.CFUNCTYPE(None, POINTER, POINTER)(code.address)

    def call(at: Array) -> Array:
        assert code.address
        found = np.empty(out.numel())
        raw(at.ctypes.data_as(POINTER), found.ctypes.data_as(POINTER))
        return found

    return call


@pytest.mark.parametrize("width", [2, 3, 4])
def test_lane_arithmetic_equals_numpy(width: int) -> None:
    """Numbers and constants in lanes, mixed with scalars, summed and extracted."""
    x = ca.SX.sym("x", 2 * width + 1)
    constants = np.random.default_rng(width).normal(size=width)
    lanes = Lanes()
    a = lanes.pack([x[k] for k in range(width)])
    b = lanes.pack([ca.cos(x[width + k]) for k in range(width)])
    c = lanes.pack([float(value) for value in constants])
    mixed = lanes.pack([x[0], *(float(value) for value in constants[1:])])
    d = (x[-1] * a - 2.0 * b) / (1.0 + c * c) + 1.0 / (3.0 + b * b) - mixed + (-a) + 2.0 * a
    deep = lanes.sum(d * x[-1], width) * d
    out = ca.vertcat(
        lanes.sum(d, width),
        *(lanes.lane(deep, k, width) for k in range(width)),
        lanes.sum(c, width),
    )
    fast = build(lanes, x, out)
    at = np.random.default_rng(0).normal(size=2 * width + 1)
    A, B, last = at[:width], np.cos(at[width:-1]), at[-1]
    M = np.array([at[0], *constants[1:]])
    D = (last * A - 2 * B) / (1 + constants**2) + 1 / (3 + B * B) - M + A
    expected = [D.sum(), *((D * last).sum() * D), constants.sum()]
    np.testing.assert_allclose(fast(at), expected, rtol=1e-13)
    at[1] = np.nan
    assert np.isnan(fast(at)[:-1]).all()


def test_pack_of_equal_constants_stays_scalar() -> None:
    """Equal constants fold as in scalar code."""
    lanes = Lanes()
    assert lanes.pack([0.0, 0.0]) == 0.0
    assert (lanes.lane(1.5, 1, 2), lanes.sum(1.5, 3)) == (1.5, 4.5)
    assert isinstance(lanes.pack([0.0, 1.0]), ca.SX)


@pytest.mark.parametrize("width", [2, 3, 4, 8])
def test_functions_without_vector_form_equal_numpy(width: int) -> None:
    """Such functions are called lane by lane, and sines of all lanes at once."""
    x, lanes = ca.SX.sym("x", width), Lanes()
    a = lanes.pack([x[k] for k in range(width)])
    value = ca.sqrt(a) + ca.atan2(a, 2.0) * ca.sin(a) - (a > 0.5) * ca.cos(a * 3.0)
    fast = build(lanes, x, ca.vertcat(*(lanes.lane(value, k, width) for k in range(width))))
    at = np.random.default_rng(1).uniform(0.0, 1.0, width)
    expected = np.sqrt(at) + np.arctan2(at, 2.0) * np.sin(at) - (at > 0.5) * np.cos(3.0 * at)
    np.testing.assert_allclose(fast(at), expected, rtol=1e-14)


def test_identical_branches_are_grouped() -> None:
    """Satellite arms are grouped in fours and pairs, with one remaining."""
    for limbs, widths in ((1, {1}), (2, {1, 2}), (4, {1, 4}), (6, {1, 2, 4})):
        system = pinred.load(limbed_model("SE3", limbs, 3, 1))
        links = links_of(bodies_of(system), Lanes(), ())
        assert {len(link.lanes) for link in links} == widths
        assert sorted(k for link in links for k in link.lanes) == list(range(system.m + 1))
        for k, link in enumerate(links[1:], 1):
            assert link.parent < k


@pytest.mark.parametrize(
    ("lengths", "expected"),
    [
        ({"root": [3, 3], "spine": [4, 4]}, [1, 1, 2, 4, 4, 4]),  # legs and arms
        ({"root": [3], "spine": [2, 1]}, [1, 1, 1, 1, 2, 2]),
        ({"root": [2], "spine": [1, 1]}, [1, 1, 1, 1, 2]),  # one pair of joints is not worth it
        ({"root": [3, 3, 3], "spine": [2, 2]}, [1, 1, 2, 2, 3, 3, 3]),  # five lanes are too many
    ],
)
def test_limbs_of_different_lengths_are_joined(
    lengths: dict[str, list[int]], expected: list[int]
) -> None:
    """Widths of all links of a robot with limbs on two bodies, sorted."""
    rng, model = np.random.default_rng(1), pin.Model()

    def add(parent: int, joint: pin.JointModel, name: str) -> int:
        i: int = model.addJoint(parent, joint, placement(rng), name)
        model.appendBodyToJoint(i, inertia(rng), pin.SE3.Identity())
        return i

    bodies = {"root": add(0, pin.JointModelFreeFlyer(), "root")}
    bodies["spine"] = add(bodies["root"], pin.JointModelRY(), "spine")
    for body, joints in lengths.items():
        for limb, length in enumerate(joints):
            above = bodies[body]
            for k in range(length):
                above = add(above, pin.JointModelRX(), f"{body}{limb}.{k}")
    system = pinred.load(model)
    links = links_of(bodies_of(system), Lanes(), ())
    assert sorted(len(link.lanes) for link in links) == expected
    for i, link in enumerate(links[1:], 1):
        above_each = [links[k].lanes[lane] for k, lane in link.parents]
        assert above_each == [bodies_of(system)[k].parent for k in link.lanes]
        assert all(k < i for k, _ in link.parents)


def test_limbs_on_balls_are_not_joined() -> None:
    """Frames of balls are constants of the code, which limbs of different kinds do not share."""
    rng, model = np.random.default_rng(1), pin.Model()
    root = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "root")
    model.appendBodyToJoint(root, inertia(rng), pin.SE3.Identity())
    for limb, length in enumerate((3, 2)):
        above = root
        for k in range(length):
            joint = pin.JointModelRX() if k else pin.JointModelSpherical()
            above = model.addJoint(above, joint, placement(rng), f"{limb}.{k}")
            model.appendBodyToJoint(above, inertia(rng), pin.SE3.Identity())
    links = links_of(bodies_of(pinred.load(model)), Lanes(), ())
    assert [len(link.lanes) for link in links] == [1] * 6


@pytest.mark.by_hand
@settings(max_examples=8)
@given(groups, st.integers(2, 6), st.integers(1, 4), seeds, st.sampled_from(MADE))
def test_kernels_with_identical_branches_equal_readable_route(
    group: str, limbs: int, joints: int, seed: int, made: Callable[..., pin.Model]
) -> None:
    """Any group, branches and joints, with and without springs."""
    check_rate(pinred.load(made(group, limbs, joints, seed)), seed)


@pytest.mark.sampled(3)
@pytest.mark.parametrize(("group", "seed"), [("SE3", 2), ("SO2", 5), ("SE2", 11)])
def test_kernels_with_joined_limbs_equal_readable_route(group: str, seed: int) -> None:
    """Limbs of different lengths, on different bodies, with forks; also with prescribed joints."""
    system = pinred.load(unequal_limbs_model(group, 6, 4, seed))
    links = links_of(bodies_of(system), Lanes(), ())
    assert any(len({i for i, _ in link.parents}) > 1 for link in links)
    check_rate(system, seed)
    rng = np.random.default_rng(seed)
    driven = {name: "0.4*sin(1.3*t)" for name in system.shape_names if rng.random() < 0.4}
    options: dict[str, Any] = {"xi0": rng.normal(size=system.r), "duration": 0.2}
    fast, slow = (
        pinred.simulate(system, prescribed=driven, engine=engine, **options)
        for engine in ("compiled", "pinocchio")
    )
    np.testing.assert_allclose(fast.x, slow.x, rtol=0, atol=1e-7)
    np.testing.assert_allclose(fast.xi, slow.xi, rtol=0, atol=1e-7 * np.abs(slow.xi).max())


def check_rate(system: pinred.System, seed: int) -> None:
    """Compare the kernel's rate at a random state with Pinocchio's, with and without NaN."""
    rng = np.random.default_rng(seed)
    springs = dict.fromkeys(system.shape_names[::3], (1.5, 0.4))
    scene = pinred.Scene(
        system=system,
        x0=rng.uniform(-2.0, 2.0, system.m),
        xdot0=rng.normal(size=system.m),
        pose0=system.group.exp(rng.uniform(-1.5, 1.5, system.r)),
        xi0=rng.normal(size=system.r),
        springs=springs,
    )
    compiled, readable = CompiledFlow.of_plan(plan_of(scene)), PinocchioFlow(plan_of(scene))
    layout, m = compiled.kernel.layout, system.m
    rate = compiled.kernel.evaluate_rate(compiled.y0, compiled.parameters)
    expected = readable.rate(0.0, readable.y0)
    active, cyclic = list(layout.active), list(layout.cyclic)
    rows = [*active, *(m + k for k in active), *cyclic, *range(2 * m, len(expected))]
    scale = max(1.0, float(np.abs(expected).max(initial=0.0)))
    np.testing.assert_allclose(rate, expected[rows], rtol=0, atol=1e-10 * scale)
    # NaN in one branch reaches the rate.
    y = np.array(compiled.y0)
    y[int(rng.integers(len(active)))] = np.nan
    assert np.isnan(compiled.kernel.evaluate_rate(y, compiled.parameters)).any()


def test_rotations_of_mirrored_branches_equal_pinocchio() -> None:
    """All combinations of angles in two lanes; a half turn in one lane is a rotation."""
    angles = [0.0, np.pi, -np.pi, np.pi / 2, -np.pi / 2, 0.7, -0.7]
    v = [0.3, -0.8, 1.7]
    for first in angles:
        for second in angles:
            lanes, x = Lanes(), ca.SX.sym("x", 3)
            pairs = [(cosine(a), sine(a)) for a in (first, second)]
            turn = Turn(2, *(lanes.pack(numbers) for numbers in zip(*pairs, strict=True)))
            assert turn.is_none == (first == second == 0.0)
            turned = turn.vector([x[0], x[1], x[2]])
            out = ca.vertcat(*(lanes.lane(turned[k], j, 2) for j in (0, 1) for k in (0, 1)))
            found = build(lanes, x, out)(np.array(v))
            expected = [pin.utils.rotate("z", a)[:2] @ v for a in (first, second)]
            np.testing.assert_allclose(found, np.ravel(expected), rtol=0, atol=1e-15)


def call_derivative(derivative: ca.Function, lanes: Lanes, columns: list[Array]) -> Array:
    """Compile and call a derivative in lanes."""
    name = derivative.name()
    code = load_object(compile_object(derivative, name, lanes.marks[name]), name)
    found = np.full(derivative.numel_out(1), np.nan)
    pointers = [column.ctypes.data_as(POINTER) for column in (*columns, found)]
    ctypes.CFUNCTYPE(None, *[POINTER] * len(pointers))(code.address)(*pointers)
    assert code.address
    return found


def lane_operations(width: int) -> tuple[ca.Function, list[Mark], ca.SX, ca.SX, ca.SX]:
    """Return a Function with all lane operations and its marks; y, p, and the same without lanes.

    Scalars are used in several lanes, lanes are extracted twice; there are sums, constants and
    unused inputs.
    """
    y, p = ca.SX.sym("y", width + 3), ca.SX.sym("p", 3)
    lanes, weights = Lanes(), np.linspace(0.5, 1.5, width)
    a = lanes.pack([y[k] for k in range(width)])
    b = lanes.pack([ca.cos(y[width]) * float(w) for w in weights])
    c = lanes.pack([y[width + 1], *(float(w) for w in weights[1:])])
    d = ca.sin(a * y[width]) * p[0] - b / (2.0 + c * c) + p[1] * p[1] * a
    total, first = lanes.sum(d * d, width), lanes.lane(d, 0, width)
    e = d * total + y[width] * a
    parts = [lanes.lane(e, k, width) for k in range(width)]
    out = [total * y[width], first * parts[0], *parts, parts[-1] * p[0], y[1], ca.SX(0.7)]
    rate = lanes.function("rate", [y, p], ca.vertcat(*out))
    C = [y[width + 1], *weights[1:].tolist()]
    D = [
        ca.sin(y[k] * y[width]) * p[0] - weights[k] * ca.cos(y[width]) / (2.0 + C[k] * C[k])
        + p[1] * p[1] * y[k]
        for k in range(width)
    ]  # fmt: skip
    whole = sum(entry * entry for entry in D)
    E = [D[k] * whole + y[width] * y[k] for k in range(width)]
    plain = ca.vertcat(whole * y[width], D[0] * E[0], *E, E[-1] * p[0], y[1], 0.7)
    return rate, lanes.marks["rate"], y, p, plain


@pytest.mark.parametrize("width", [2, 4])
def test_derivatives_of_lane_operations_equal_casadi(width: int) -> None:
    """The adjoint, and the value with its tangent, against CasADi's modes without lanes."""
    rate, marks, y, p, plain = lane_operations(width)
    covector, v = ca.SX.sym("l", plain.numel()), ca.SX.sym("v", y.numel() + p.numel())
    both, inputs = ca.vertcat(y, p), [y, p, covector, v]
    slopes = [ca.jtimes(plain, both, covector, True), ca.jtimes(plain, both, v)]
    rng = np.random.default_rng(width)
    columns = [rng.normal(size=column.numel()) for column in inputs]
    expected, value, slope = (
        np.array(result)[:, 0]
        for result in ca.Function("slopes", inputs, [slopes[0], plain, slopes[1]])(*columns)
    )
    others = Lanes()
    adjoint = adjoint_in_lanes(rate, marks, others, "adjoint")
    found = call_derivative(adjoint, others, columns[:3])
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * np.abs(expected).max())
    assert found[width + 2] == found[-1] == 0.0  # inputs that are not used
    others = Lanes()
    pair = tangent_in_lanes(rate, marks, others, "pair")
    along = [columns[3][: y.numel()].copy(), columns[3][y.numel() :].copy()]
    found = call_derivative(pair, others, [*columns[:2], *along])
    np.testing.assert_allclose(found[: len(value)], value, rtol=0, atol=1e-14 * abs(value).max())
    np.testing.assert_allclose(found[len(value) :], slope, rtol=0, atol=1e-13 * abs(slope).max())
    assert found[-1] == 0.0  # a constant


# Case SE3-2 contains the planar terms.
@pytest.mark.by_hand("SE2-4")
@pytest.mark.sampled
@pytest.mark.parametrize(("group", "limbs"), [("SE3", 2), ("SO3", 3), ("SE2", 4), ("SE3", 5)])
def test_derivatives_with_identical_branches_equal_casadi(group: str, limbs: int) -> None:
    """CasADi's derivatives of the equations without lanes are the same."""
    made = unequal_limbs_model(group, 5, 3, 8) if limbs == 5 else limbed_model(group, limbs, 2, 1)
    system, structure = pinred.load(made), Structure(zero_momentum=False)
    plain, lanes = ReducedGraph(system, structure).rate(), Lanes()
    rate = ReducedGraph(system, structure, lanes=lanes).rate()
    marks = lanes.marks[rate.name()]
    assert marks
    sizes = [plain.numel_in(0), plain.numel_in(1), plain.numel_out(0)]
    y, p, covector = (ca.SX.sym("v", size) for size in sizes)
    dy, dp, both = ca.SX.sym("dy", sizes[0]), ca.SX.sym("dp", sizes[1]), ca.vertcat(y, p)
    value, inputs = plain(y, p), [y, p, covector, dy, dp]
    slopes = [ca.jtimes(value, both, covector, True), ca.jtimes(value, both, ca.vertcat(dy, dp))]
    rng = np.random.default_rng(limbs)
    columns = [0.7 * rng.normal(size=column.numel()) for column in inputs]
    expected, along = (
        np.array(result)[:, 0] for result in ca.Function("slopes", inputs, slopes)(*columns)
    )
    others = Lanes()
    adjoint = adjoint_in_lanes(rate, marks, others, "adjoint")
    found = call_derivative(adjoint, others, columns[:3])
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11 * np.abs(expected).max())
    others = Lanes()
    pair = tangent_in_lanes(rate, marks, others, "pair")
    found = call_derivative(pair, others, [*columns[:2], *columns[3:]])[sizes[2] :]
    np.testing.assert_allclose(found, along, rtol=0, atol=1e-11 * np.abs(along).max())


def test_graph_size_hardly_grows_with_identical_branches() -> None:
    """The graph of four branches is hardly larger than that of two."""
    sizes = {}
    for limbs in (1, 2, 4):
        lanes = Lanes()
        system = pinred.load(limbed_model("SE3", limbs, 4, 3))
        function = ReducedGraph(system, Structure(zero_momentum=False), lanes=lanes).rate()
        sizes[limbs] = function.n_instructions()
    assert sizes[4] < 1.3 * sizes[2] < 1.7 * sizes[1]


def test_divided_kernel_with_lanes_agrees_with_pinocchio(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The functions of long code pass vectors to each other; the build compares with Pinocchio."""
    system, structure = pinred.load("satellite_two_arms"), Structure(zero_momentum=False)
    expected = build_kernel(system, structure)
    monkeypatch.setattr(native, "LONG", 0)
    monkeypatch.setattr(native, "PART", 50)
    divided = build_kernel(system, structure, cache=ObjectCache(tmp_path))
    at = random_state(divided, np.random.default_rng(0), 1.0)
    assert at is not None
    found, rate = (kernel.evaluate_rate(at.y, at.parameters) for kernel in (divided, expected))
    assert not np.array_equal(found, rate)
    np.testing.assert_allclose(found, rate, rtol=0.0, atol=1e-13 * np.abs(rate).max())
