"""Motions of robots with ball joints: initial states, all integrators, batches, files."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import aba
import numpy as np
import pinocchio as pin
import pytest
from ball_trees import ball_tree, joined_bodies
from taylor_series import two_bodies

import pinred
from pinred import InputError, ShapeError
from pinred.forces import BallSpring
from pinred.lie.rotations import quaternion_exp, quaternion_log, quaternion_product, rotation

METHODS = ["DOP853", "Tsit5", "Radau", "AdaptiveGauss", "RKMK4(0.005)", "Gauss(0.02, 8)"]


@pytest.fixture(scope="module")
def tree() -> pinred.System:
    """A tree with a ball, a hinge and a slide."""
    return ball_tree(12, 3)


@pytest.fixture(scope="module")
def end_by_aba(tree: pinred.System) -> np.ndarray:
    """Shape and pose at 0.6 s by an independent integration of ABA."""
    scene = pinred.Scene(system=tree, seed=1, duration=0.6)
    start = scene.start
    q0, v0 = tree.sorted_q(start.pose, start.x), tree.sorted_v(start.xi, start.xdot)
    q, _ = aba.integrate(tree.sorted_model, q0, v0, np.array([0.0, 0.6]), rtol=1e-13)
    return np.asarray(q[-1])


@pytest.mark.parametrize("method", METHODS)
def test_motion_with_balls_equals_aba(
    tree: pinred.System, end_by_aba: np.ndarray, method: str
) -> None:
    """Each integrator ends where SciPy with ABA ends, with unit quaternions at all report times."""
    traj = pinred.simulate(tree, seed=1, duration=0.6, method=method, rtol=1e-11, atol=1e-13)
    error = pin.difference(tree.sorted_model, end_by_aba, tree.sort_q(traj.q[-1]))
    assert np.abs(error).max() <= (1e-9 if method.startswith("RKMK4") else 2e-12)
    lengths = np.linalg.norm(traj.x[:, tree.space.ball_x].reshape(-1, 4), axis=1)
    assert np.abs(lengths - 1.0).max() <= 1e-15


@pytest.mark.parametrize("engine", ["compiled", "pinocchio"])
def test_compare_passes_with_balls(tree: pinred.System, engine: Any) -> None:
    """The judge accepts both engines."""
    report = pinred.compare(pinred.simulate(tree, seed=2, duration=0.5, engine=engine, rtol=1e-9))
    assert report.passed, str(report)


def test_compare_detects_wrong_placement_of_ball(monkeypatch: pytest.MonkeyPatch) -> None:
    """A placement that differs by a relative 1e-6 from the simulated robot fails."""
    system = ball_tree(12, 3)
    scene = pinred.Scene(system=system, seed=2, duration=0.5, rtol=1e-9)
    traj = pinred.simulate(scene)
    wrong = system.sorted_model.copy()
    place = wrong.jointPlacements[2]
    wrong.jointPlacements[2] = pin.SE3(place.rotation, place.translation * (1.0 + 1e-6))
    monkeypatch.setitem(vars(system), "sorted_model", wrong)
    vars(system).pop("_once", None)
    assert not pinred.compare(traj).passed


@pytest.mark.by_hand
@pytest.mark.parametrize("seed", range(10))
def test_compare_passes_on_random_trees(seed: int) -> None:
    """Ten trees over 2 s."""
    traj = pinred.simulate(ball_tree(seed, 5), seed=seed, duration=2.0, rtol=1e-10)
    report = pinred.compare(traj)
    assert report.passed, str(report)


def test_rotation_vector_quaternion_and_position_state_same_attitude() -> None:
    """All forms of x0 and xdot0 give the same initial state."""
    system, w = joined_bodies(), np.array([0.3, -0.2, 0.5])
    q = quaternion_exp(w)
    forms: list[Any] = [{"joint": w}, {"joint": list(-2.0 * q)}, q, 3.0 * q]
    for x0 in forms:
        start = pinred.Scene(system=system, x0=x0, xdot0={"joint": (1, 0, 0)}).start
        np.testing.assert_allclose(rotation(start.x), pin.exp3(w), atol=1e-15)
        np.testing.assert_array_equal(start.xdot, (1.0, 0.0, 0.0))
    rate = pinred.Scene(system=system, x0={}, xdot0={"joint.y": 2.0}).start.xdot
    np.testing.assert_array_equal(rate, (0.0, 2.0, 0.0))


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [
        ("x0", {"joint": (0, 0, 0, 0)}, r"x0\['joint'\]: the quaternion of a ball joint must not"),
        ("x0", (0, 0, 0, 0), "x0: the quaternion of ball joint 'joint' must have length one"),
        ("x0", {"joint": 0.3}, r"x0\['joint'\] is a ball joint: expected a rotation vector of 3"),
        ("x0", {"joint": (0.1, 0.2)}, "expected a rotation vector of 3 numbers or a quaternion"),
        ("x0", {"joint": (np.nan, 0, 0)}, r"x0\['joint'\] must be finite"),
        ("x0", {"joint.qx": 0.1}, "set joint 'joint' as a whole"),
        ("x0", {"neck": 0.1}, "no shape joint 'neck'; .*the joints are joint"),
        ("xdot0", {"joint": (1, 0, 0, 0)}, "expected an angular velocity of 3 numbers"),
        ("xdot0", {"joint": (1, 0, 0), "joint.x": 2}, "set joint 'joint' as a whole"),
        ("q0", (0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0.5), "ball joint 'joint' must have length one"),
    ],
)
def test_invalid_attitude_is_refused(option: str, value: Any, message: str) -> None:
    """Errors name the option and the joint."""
    with pytest.raises((InputError, ShapeError), match=message):
        pinred.Scene(system=joined_bodies(), **{option: value})


# The other case has no momentum, and other tests have momentum.
# Every run has the Taylor series of test_symmetric_balls.
@pytest.mark.by_hand
@pytest.mark.by_hand("2.0-AdaptiveGauss")
@pytest.mark.parametrize("method", ["DOP853", "AdaptiveGauss"])
@pytest.mark.parametrize("stiffness", [0.0, 2.0])
@pytest.mark.sampled
def test_bodies_on_ball_at_their_centres_equal_taylor_series(stiffness: float, method: str) -> None:
    """Attitudes over 3 s to 1e-12 of series with 30 digits; an ideal ball exerts no moment."""
    moments = np.array([[0.4, 0.5, 0.7], [0.2, 0.3, 0.4]])
    system = joined_bodies(moments, np.zeros((2, 3)))
    xi, sigma = np.array([0.0, 0.0, 0.0, 1.0, 2.0, -0.5]), np.array([0.5, -1.5, 2.0])
    q, times = quaternion_exp(np.array([0.4, 0.3, -0.2])), np.linspace(0.0, 3.0, 13)
    forces = [BallSpring("joint", stiffness, law="cosine")] if stiffness else []
    traj = pinred.simulate(
        system, x0=q, xdot0=sigma, xi0=xi, forces=forces, times=times, rtol=1e-13, atol=1e-14,
        method=method,
    )  # fmt: skip
    omegas = [xi[3:], rotation(q).T @ xi[3:] + sigma]
    expected = two_bodies(moments, omegas, [[0.0, 0.0, 0.0, 1.0], q], stiffness, times)
    space = traj.pose[:, 3:]
    for body, found in enumerate((space, quaternion_product(space, traj.x))):
        error = quaternion_product(expected[:, body] * [-1.0, -1.0, -1.0, 1.0], found)
        assert np.abs(quaternion_log(error)).max() <= 1e-12


MOTION: dict[str, Any] = {
    "x0": {"joint": (0.5, 0.2, 0.1)},
    "xdot0": {"joint": (1.0, -0.5, 0.7)},
    "xi0": np.array([0.0, 0.0, 0.0, 0.3, 0.8, -0.2]),
}


def test_gauss_with_lifted_balls_keeps_energy_and_lengths() -> None:
    """Order 4 over 40 s: the energy error does not drift, and momentum is exact."""
    system = joined_bodies()
    traj = pinred.simulate(system, **MOTION, duration=40.0, method="Gauss(0.05, 4)")
    error = traj.energy / traj.energy[0] - 1.0
    first, last = np.abs(error[:50]).max(), np.abs(error[-50:]).max()
    assert 1e-9 < first < 2e-5
    assert last <= 1.5 * first
    J = traj.spatial_momentum[:, 3:]
    assert np.abs(J - J[0]).max() <= 1e-12


@pytest.mark.parametrize(
    ("method", "order"), [("Gauss({h}, 4)", 4), ("RKMK4({h})", 4), ("Variational({h})", 2)]
)
def test_fixed_step_methods_keep_their_order_with_balls(method: str, order: int) -> None:
    """Halving the step divides the error by 2 to the order."""
    system = joined_bodies()
    exact = pinred.simulate(system, **MOTION, times=[1.0], rtol=1e-13, atol=1e-14)
    errors = []
    for h in (0.02, 0.01):
        traj = pinred.simulate(system, **MOTION, times=[1.0], method=method.format(h=h))
        errors.append(
            np.abs(
                quaternion_log(
                    quaternion_product(exact.x[-1] * np.array([-1, -1, -1, 1]), traj.x[-1])
                )
            ).max()
        )
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.3)


def test_members_with_balls_equal_single_runs(tree: pinred.System) -> None:
    """Attitudes of members by name, in SIMD lanes."""
    rng = np.random.default_rng(0)
    rotations = rng.uniform(-1.0, 1.0, (5, 3))
    ball = tree.space.balls[0].name
    many = pinred.simulate_many(
        tree, x0={ball: rotations}, xdot0={f"{ball}.x": np.ones(5)}, duration=0.3, rtol=1e-10
    )
    for k, w in enumerate(rotations):
        one = pinred.simulate(
            tree, x0={ball: w}, xdot0={f"{ball}.x": 1.0}, duration=0.3, rtol=1e-10
        )
        np.testing.assert_allclose(many.x[k], one.x, atol=1e-10)
        np.testing.assert_allclose(many.pose[k], one.pose, atol=1e-10)


def test_files_and_copies_with_balls_keep_all_arrays(tree: pinred.System, tmp_path: Path) -> None:
    """Recordings, labelled arrays and pickles."""
    traj = pinred.simulate(tree, seed=1, duration=0.2, rtol=1e-9)
    traj.save(tmp_path / "motion.npz")
    read = pinred.read_recording(tmp_path / "motion.npz")
    np.testing.assert_array_equal(read.x, traj.x)
    np.testing.assert_array_equal(read.xdot, traj.xdot)
    copy = pickle.loads(pickle.dumps(tree))
    assert copy.x_names == tree.x_names
    assert copy.space.balls[0].kind is tree.space.balls[0].kind
    pytest.importorskip("xarray")
    labels = traj.to_xarray()
    assert list(labels["x"].coords["shape"].values) == list(tree.x_names)
    assert list(labels["xdot"].coords["joint"].values) == list(tree.shape_names)


@pytest.mark.parametrize(
    "name",
    [
        "falling_cat_ball",
        *(pytest.param(name, marks=pytest.mark.by_hand) for name in ("diver", "astronaut")),
    ],
)
def test_bundled_robots_with_balls_pass_compare(name: str) -> None:
    """The first second of their generic motion; `balls=[]` keeps the hinges."""
    system = pinred.load(name)
    traj = pinred.simulate(system, duration=1.0)
    report = pinred.compare(traj)
    assert report.passed, str(report)
    with pytest.warns(pinred.ModelWarning, match="singular at single shapes"):
        hinges = pinred.load(name, balls=[])
    assert not hinges.space.balls
    assert hinges.m == system.m


def test_ball_takes_equal_steps_near_gimbal_lock_of_hinges() -> None:
    """The same motion at distances 1 to 1e-4 from the lock: hinges need ever more steps."""
    system = pinred.load("falling_cat_ball")
    with pytest.warns(pinred.ModelWarning, match="singular at single shapes"):
        hinges = pinred.load("falling_cat_ball", balls=[])
    steps, hinge_steps = [], []
    for distance in (1.0, 1e-1, 1e-2, 1e-3, 1e-4):
        angles = np.array([0.2, 0.5 * np.pi - distance, 0.3])  # about y, x and z in turn
        R = (
            pin.utils.rotate("y", 0.2)
            @ pin.utils.rotate("x", angles[1])
            @ pin.utils.rotate("z", 0.3)
        )
        xi, sigma = np.array([0.0, 0.0, 0.0, 0.3, -0.2, 0.4]), np.array([0.8, -0.5, 0.6])
        q = pin.Quaternion(R).coeffs()
        options: dict[str, Any] = {"xi0": xi, "times": [4.0], "method": "DOP853", "rtol": 1e-12}
        ball = pinred.simulate(system, x0=q, xdot0=sigma, **options)
        model, data = hinges.sorted_model, hinges.sorted_model.createData()
        pin.computeJointJacobians(model, data, hinges.sorted_q(hinges.group.identity(), angles))
        jacobian = pin.getJointJacobian(model, data, 4, pin.LOCAL)[3:, 6:]
        rates = np.linalg.solve(jacobian, sigma)
        triple = pinred.simulate(hinges, x0=angles, xdot0=rates, **options)
        if distance >= 1e-2:
            error = pin.log3(
                triple.system.group.matrix(triple.pose[-1])[:3, :3].T
                @ system.group.matrix(ball.pose[-1])[:3, :3]
            )
            assert np.abs(error).max() <= 1e-5
        steps.append(ball.run.steps)
        hinge_steps.append(triple.run.steps)
    assert max(steps[1:]) <= 1.1 * min(steps[1:]), steps
    assert hinge_steps[-1] > 3 * max(steps), hinge_steps
