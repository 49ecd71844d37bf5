"""Tests of the perturbed robot with which kernels with variable parameters are validated.

Variable parameters change enough to detect a kernel that ignores them, and stay physical.  All
other parameters stay equal.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from trees import placement, random_model

import pinred
from pinred.common.arrays import Array
from pinred.kernels.reference_state import length_of, perturb_parameters
from pinred.reduction.tree.body_frames import bodies_of
from pinred.reduction.tree.free_bodies import STEP, Freed, other_placement, pattern_of, step_of_body


def tree(*, gravity: float = 5.0) -> pinred.System:
    """Return a tree with a link on each body, the first 0.1 m from the origin, the last in it."""
    model, rng = random_model("SE3", 4, 2), np.random.default_rng(0)
    model.gravity.linear = gravity * np.array([1.0, -2.0, 3.0])
    for i in range(1, model.njoints):
        place = placement(rng) if i < model.njoints - 1 else pin.SE3.Identity()
        if i == 1:
            place.translation = np.array([0.0, 0.06, 0.08])
        model.addFrame(pin.Frame(f"tip{i}", i, 0, place, pin.FrameType.BODY), False)
    return pinred.load(model)


def moments(body: pin.Inertia) -> tuple[float, Array]:
    """Return the radius of gyration of a body, and its principal moments."""
    return float(np.sqrt(np.trace(body.inertia) / body.mass)), np.linalg.eigvalsh(body.inertia)


@pytest.mark.parametrize("arm", [0.0, 0.2, 50.0])
def test_perturb_changes_variable_inertias_physically(arm: float) -> None:
    """Each variable inertia changes clearly and stays physical; the others stay equal."""
    model = tree().model.copy()
    for i in range(1, model.njoints):
        own = model.inertias[i]
        model.inertias[i] = pin.Inertia(own.mass, arm * np.array([1.0, -0.5, 0.7]), own.inertia)
    system, freed = pinred.load(model), (0, 2, 3)
    other = perturb_parameters(system, Freed(inertias=freed))
    for i in range(system.m + 1):
        own, found = system.model.inertias[i + 1], other.model.inertias[i + 1]
        if i not in freed:
            assert found == own
            continue
        radius, before = moments(own)
        after = moments(found)[1]
        assert 0.5 <= found.mass / own.mass <= 1.5
        assert abs(found.mass / own.mass - 1.0) > 1e-3
        apart = np.abs(found.lever - own.lever)
        size = radius + 1e-3 * np.linalg.norm(own.lever)
        assert (apart > 1e-3 * size).all()
        assert (apart < 4.0 * size).all()
        turned = np.abs(found.inertia - own.inertia)
        assert (turned > 1e-3 * before[0]).all()
        assert (turned < 40.0 * found.mass * size**2).all()
        assert after[0] > 0.0
        assert after[2] < after[0] + after[1]
    assert system.model.inertias[1] != other.model.inertias[1]


@pytest.mark.parametrize("radius", [0.0, 0.5e-3])
def test_perturb_gives_point_masses_an_extent(radius: float) -> None:
    """A small body far out gets an extent of a thousandth of its lever."""
    model, lever = tree().model.copy(), np.array([0.3, 0.0, 0.4])
    model.inertias[5] = pin.Inertia(1.0, lever, radius**2 / 3.0 * np.eye(3))
    model.armature = np.append(np.zeros(6), np.ones(model.nv - 6))
    found = perturb_parameters(pinred.load(model), Freed(inertias=(4,))).model.inertias[5]
    reach = radius + 0.5e-3
    assert 1.5 * reach < moments(found)[0] < 6.0 * reach
    assert 0.2 * reach < np.linalg.norm(found.lever - lever) < 4.0 * reach


def test_perturb_scales_bodies_on_cyclic_joints() -> None:
    """Their inertias are scaled by 1.2 to 1.5, because the joint must stay cyclic."""
    system = pinred.load("reaction_wheel_satellite")
    wheels = range(system.m)
    freed = Freed(inertias=tuple(range(system.m + 1)))
    other = perturb_parameters(system, freed, tuple(wheels))
    for k in wheels:
        joint = system.joints[k]
        own, found = system.model.inertias[joint], other.model.inertias[joint]
        ratio = found.mass / own.mass
        assert 1.2 <= ratio <= 1.5
        assert found.lever.tolist() == own.lever.tolist()
        np.testing.assert_allclose(found.inertia, ratio * own.inertia, rtol=1e-12)
    root = other.model.inertias[1]
    assert np.abs(root.lever - system.model.inertias[1].lever).min() > 1e-3
    # Bodies carried by a cyclic joint are scaled, too, and no others.
    chain = tree()
    parents = list(chain.model.parents)
    carrying = next(k for k in range(chain.m) if chain.joints[k] in parents)
    first, carried = chain.joints[carrying], {chain.joints[carrying]}
    for i in range(first + 1, chain.model.njoints):
        carried |= {i} & {i for p in carried if parents[i] == p}
    assert 1 < len(carried) < chain.m + 1
    other = perturb_parameters(chain, Freed(inertias=tuple(range(chain.m + 1))), (carrying,))
    for i in range(1, chain.model.njoints):
        same = other.model.inertias[i].lever.tolist() == chain.model.inertias[i].lever.tolist()
        assert same is (i in carried)


def test_perturb_changes_variable_placements() -> None:
    """Variable placements of joints and links change by a good fraction of their size."""
    system = tree()
    moved, links = 2, (1, 2, 4, 5)
    freed = Freed(steps=((moved, pattern_of(system, moved)),), links=links)
    other = perturb_parameters(system, freed)
    own, found = system.model, other.model
    for i in range(1, own.njoints):
        apart = own.jointPlacements[i].actInv(found.jointPlacements[i])
        assert apart.isIdentity(1e-9) is (i != moved + 1)
        assert found.inertias[i] == own.inertias[i]
    for k in range(own.nframes):
        before, after = own.frames[k].placement, found.frames[k].placement
        if k not in links:
            assert after == before
            continue
        apart = before.actInv(after)
        size = 0.1 * length_of(system) + np.linalg.norm(before.translation)
        assert (np.abs(apart.translation) >= 0.1 * size).all()
        assert (np.abs(apart.translation) <= 0.5 * size).all()
        turn = pin.log3(apart.rotation)
        assert (turn >= 0.1).all()
        assert (turn <= 0.4).all()


@pytest.mark.parametrize("gravity", [0.0, 5.0])
def test_perturb_scales_gravity(gravity: float) -> None:
    """Gravity grows by a factor and keeps its direction; zero stays zero."""
    system = tree(gravity=gravity)
    other = perturb_parameters(system, Freed(inertias=(1,)))
    np.testing.assert_allclose(other.gravity, 1.3 * system.gravity)
    np.testing.assert_allclose(other.model.gravity.linear, other.gravity)


def test_step_without_variable_parameters_gives_the_placement_of_the_joint() -> None:
    """The angles, offset and shift of a step are those of Pinocchio's placement."""
    system, rng = tree(), np.random.default_rng(0)
    bodies = bodies_of(system)
    compared = 0
    for i in range(1, len(bodies)):
        found = other_placement(bodies[bodies[i].parent], bodies[i], "0" * STEP, 1.0, rng)
        expected = system.model.jointPlacements[i + 1]
        np.testing.assert_allclose(found.homogeneous, expected.homogeneous, rtol=0, atol=1e-12)
        step = step_of_body(bodies[i])
        compared += abs(step[1] - step[2]) > 1e-2 and abs(step[3] - step[1]) > 1e-2
    assert compared >= 3
