"""The page's JavaScript, run by node: A against Pinocchio's, loops against `phase`."""

from __future__ import annotations

import json
import shutil
import subprocess
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.common.arrays import Array
from pinred.system.joints import axes_of
from pinred.system.loops.kinematics import loop_values
from pinred.views.feel.feel_page import (
    feel_graphs,
    feel_page,
    felt_robot,
    loop_numbers,
    to_javascript,
)
from pinred.views.playback.page import resource

NODE = shutil.which("node")
pytestmark = pytest.mark.skipif(NODE is None, reason="node is not installed")
ROBOTS = (
    "falling_cat", "falling_cat_ball", "satellite_two_arms", "three_rods", "planar_chain5",
    "coupled_planar", "upright_drone",
)  # fmt: skip
PROGRAM = """
const m = %(m)d, W = %(shapes)s, motion = lifter(m, twist), J = %(momentum)s;
const unit = (k) => Array.from({ length: m }, (_, i) => Number(i === k));
const A = W.map((w) => w.map((_, k) => motion.velocity(w, unit(k))));
const shapes = loopsAbout(W[0], m > 1 ? [0, 1] : [0]).shapes;
const phases = m < 2 ? [] : Object.values(shapes).map((make) => {
  const g = motion.phase(make([0.2, -0.1], [0.7, 0.6]));
  return [...g.p, ...g.q];
});
let turned = null;
if (J && m > 1) {
  const circle = shapes.circle([0.2, -0.1], [0.7, 0.6])[0];
  const g = motion.along(IDENTITY, circle, 0, 1, 400, J, 1.0);
  turned = [...g.p, ...g.q];
}
const places = new Float64Array(%(places)d);
placements(W[0], places);
console.log(JSON.stringify({ A, phases, turned, places: [...places] }));
"""


def run_page(connection: pinred.Connection, shapes: Array, momentum: Array) -> dict[str, Any]:
    """Run the scripts of the page for some shapes and a spatial momentum (6,)."""
    assert connection.system is not None
    assert NODE is not None
    graphs = feel_graphs(connection, connection.system)
    scripts = [to_javascript(name, function) for name, function in vars(graphs).items()]
    scripts += [resource(f"../feel/{name}") for name in ("lift.js", "closed_shapes.js", "loops.js")]
    scripts.append(PROGRAM % {
        "m": connection.m, "shapes": json.dumps(shapes.tolist()),
        "momentum": json.dumps(momentum.tolist()), "places": graphs.placements.numel_out(),
    })  # fmt: skip
    done = subprocess.run([NODE, "-"], input="\n".join(scripts), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return dict(json.loads(done.stdout))


def gaits(w: Array) -> list[pinred.Gait]:
    """Return the four presets about (0.2, −0.1) as gaits; other joints keep their values in w."""
    m, c, a = len(w), np.array([0.2, -0.1]), np.array([0.7, 0.6])
    mean, zero = w.copy(), np.zeros((2, m))
    mean[:2] = c

    def polygon(corners: list[tuple[int, int]]) -> pinred.Gait:
        points = np.tile(w, (len(corners), 1))
        points[:, :2] = c + a * np.array(corners)
        return pinred.Gait.waypoints(points)

    circle_cos, circle_sin, eight = zero.copy(), zero.copy(), zero.copy()
    circle_cos[0, 0], circle_sin[0, 1] = a
    eight[0, 0], eight[1, 1] = a
    return [
        pinred.Gait.fourier(mean, circle_cos, circle_sin),
        polygon([(1, 1), (-1, 1), (-1, -1), (1, -1)]),
        pinred.Gait.fourier(mean, zero, eight),
        polygon([(1, 1), (-1, -1)]),
    ]


def distance(connection: pinred.Connection, pose: Array, placement: list[float]) -> float:
    """Return the distance between a pose of the group and a placement of the root joint."""
    system = connection.system
    assert system is not None
    q = system.q(pose, system.space.neutral)
    data = system.model.createData()
    pin.forwardKinematics(system.model, data, q)
    place = system.model.jointPlacements[1].actInv(data.oMi[1])
    return float(np.linalg.norm(pin.log6(place.actInv(pin.XYZQUATToSE3(np.array(placement))))))


# Another planar robot runs by default.
@pytest.mark.by_hand("three_rods")
@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.sampled
def test_page_agrees_with_connection_and_phase(name: str) -> None:
    """A within 1e-13, four loops within 3e-10, and placements and a loop with momentum, too."""
    system = pinred.load(name)
    connection = pinred.Connection.mechanical(system).in_chart()
    m = connection.m
    w = np.random.default_rng(3).uniform(-1.5, 1.5, (4, m))
    w[0] = 0.3 * np.cos(np.arange(m))
    S = axes_of(system.model.joints[1])
    inertia = connection.locked(np.zeros(m))
    J = inertia @ np.where(np.arange(system.r) < system.group.linear, 0.0, 0.4)
    page = run_page(connection, w, S @ J)
    for shape, columns in zip(w, page["A"], strict=True):
        np.testing.assert_allclose(-S.T @ np.array(columns).T, connection.local(shape), atol=1e-13)
    x = w[0] if connection.chart is None else connection.chart.shapes(w[0])
    data = system.model.createData()
    com = pin.centerOfMass(system.model, data, system.q(system.group.identity(), x))
    np.testing.assert_allclose(page["places"][-3:], data.oMi[1].actInv(com), atol=1e-14)
    for i in range(2, system.model.njoints):
        place = pin.XYZQUATToSE3(np.array(page["places"][7 * (i - 2) : 7 * (i - 1)]))
        wanted = data.oMi[1].actInv(data.oMi[i])
        np.testing.assert_allclose(place.homogeneous, wanted.homogeneous, atol=1e-14)
    if m < 2:
        return
    for gait, found in zip(gaits(w[0]), page["phases"], strict=True):
        assert distance(connection, pinred.phase(connection, gait).pose, found) < 3e-10
    pushed = pinred.phase(connection, gaits(w[0])[0], J, tolerance=1e-11)
    assert distance(connection, pushed.pose, page["turned"]) < 1e-7
    assert distance(connection, pushed.geometric, page["turned"]) > 1e-2


@pytest.mark.by_hand
def test_page_of_a_swimmer_agrees_with_its_phase() -> None:
    """The page takes other connections, too: drag defines no momentum."""
    third = 1.0 / 3.0
    rods = {
        name: pinred.Rod(third, across=2.0, along=1.0, centre=(at, 0.0, 0.0))
        for name, at in (("rear", -third / 2), ("middle", 0.0), ("front", third / 2))
    }
    swimmer = pinred.Connection.viscous(pinred.load("purcell_swimmer"), rods)
    page = run_page(swimmer, np.array([[0.3, 0.2]]), np.zeros(6))
    for gait, found in zip(gaits(np.array([0.3, 0.2])), page["phases"], strict=True):
        assert distance(swimmer, pinred.phase(swimmer, gait).pose, found) < 3e-10


def test_unsuitable_arguments_are_rejected() -> None:
    """Motions, robots without joints, options of playback, and unknown joints."""
    with pytest.raises(pinred.InputError, match="no joints"):
        feel_page(pinred.load("rigid_body"))
    with pytest.raises(pinred.InputError, match="wrong"):
        feel_page(pinred.load("three_rods"), pair=["wrong", "alpha1"])
    with pytest.raises(pinred.InputError, match="no option 'ghost'"):
        pinred.save_html(pinred.load("three_rods"), "a.html", feel=True, ghost=True)
    with pytest.raises(pinred.InputError, match="feel=True"):
        pinred.save_html(pinred.load("three_rods"), "a.html")


LOOPED = """
const head = %(head)s, shapes = closedShapes(head, %(size)d, loops);
const motion = lifter(%(size)d, twist, shapes), d = head.independent.length;
const unit = (k) => Array.from({ length: d }, (_, i) => Number(i === k));
const A = %(shapes)s.map((u) => unit(0).map((_, k) => motion.velocity(u, unit(k))));
const closed = %(shapes)s.map((u) => shapes.shape(u));
const rest = %(shapes)s[0], c = [rest[0] + 0.03, rest[1] - 0.02];
const phases = d < 2 ? [] : Object.values(loopsAbout(rest, [0, 1]).shapes).map((make) => {
  const g = motion.phase(make(c, [0.2, 0.15]));
  return [...g.p, ...g.q];
});
let stopped = "";
try { shapes.shape(%(far)s); } catch (error) {
  if (!(error instanceof OutOfReach)) throw error;
  stopped = error.message;
}
const after = shapes.shape(rest);
console.log(JSON.stringify({ A, phases, closed, stopped, after }));
"""


@pytest.mark.parametrize("name", ["four_bar", "gripper", "parallel_biped"])
@pytest.mark.sampled
def test_page_closes_loops_as_the_connection(name: str) -> None:
    """A of independent joints within 1e-13, loops within 3e-10, and a refusal out of reach."""
    assert NODE is not None
    system = pinred.load(name)
    connection = pinred.Connection.mechanical(system)
    robot = felt_robot(system)
    graphs = feel_graphs(robot.connection, system)
    rest = robot.rest[robot.independent]
    assert robot.names == connection.joints
    shapes = rest + 0.1 * np.random.default_rng(1).uniform(-1.0, 1.0, (4, robot.dim))
    shapes[0] = rest
    scripts = [to_javascript(key, function) for key, function in vars(graphs).items()]
    scripts += [resource(f"../feel/{file}") for file in ("lift.js", "closed_shapes.js", "loops.js")]
    scripts.append(LOOPED % {
        "head": json.dumps(loop_numbers(robot)), "size": system.m,
        "shapes": json.dumps(shapes.tolist()), "far": json.dumps((rest + 9.0).tolist()),
    })  # fmt: skip
    done = subprocess.run([NODE, "-"], input="\n".join(scripts), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    page = json.loads(done.stdout)
    S = axes_of(system.model.joints[1])
    for u, columns, closed in zip(shapes, page["A"], page["closed"], strict=True):
        local = connection.local(u)
        scale = max(1.0, float(np.abs(local).max()))
        np.testing.assert_allclose(-S.T @ np.array(columns).T, local, atol=1e-13 * scale)
        np.testing.assert_allclose(closed, robot.shape(u), atol=1e-13)
        assert np.abs(loop_values(system, np.array(closed))).max() < 1e-14
    assert page["stopped"]
    np.testing.assert_allclose(page["after"], page["closed"][0], atol=1e-13)
    wanted = loop_gaits(rest) if robot.dim > 1 else []
    for gait, found in zip(wanted, page["phases"], strict=True):
        pose = pinred.phase(connection, gait).pose
        assert system.closure is not None
        data = system.model.createData()
        pin.forwardKinematics(system.model, data, system.q(pose, system.closure.x))
        place = system.model.jointPlacements[1].actInv(data.oMi[1])
        error = pin.log6(place.actInv(pin.XYZQUATToSE3(np.array(found)))).vector
        assert np.linalg.norm(error) < 3e-10


def loop_gaits(rest: Array) -> list[pinred.Gait]:
    """Return the presets about (0.03, −0.02) beside rest, with half widths 0.2 and 0.15."""
    mean, a = rest.copy(), np.array([0.2, 0.15])
    mean[:2] += [0.03, -0.02]
    zero = np.zeros((2, len(rest)))
    cosine, sine, eight = zero.copy(), zero.copy(), zero.copy()
    cosine[0, 0], sine[0, 1] = a
    eight[0, 0], eight[1, 1] = a

    def polygon(corners: list[tuple[int, int]]) -> pinred.Gait:
        points = np.tile(mean, (len(corners), 1))
        points[:, :2] += a * np.array(corners)
        return pinred.Gait.waypoints(points)

    return [
        pinred.Gait.fourier(mean, cosine, sine),
        polygon([(1, 1), (-1, 1), (-1, -1), (1, -1)]),
        pinred.Gait.fourier(mean, zero, eight),
        polygon([(1, 1), (-1, -1)]),
    ]
