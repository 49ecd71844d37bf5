"""The table of docs/robots.md that states which functions support closed loops."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from loop_robots import five_bar

import pinred
from pinred.common.errors import UnsupportedOperationError

PAGE = Path(__file__).parents[2] / "docs/robots.md"
CRANKS = ["left_crank", "right_crank"]


@cache
def linkage() -> pinred.System:
    """Return the five-bar linkage, also used as a robot in a fluid and on wheels."""
    model, loops = five_bar()
    return pinred.load(model, loops=loops)


@cache
def connection() -> pinred.Connection:
    """Return its mechanical connection over the cranks."""
    return pinred.Connection.mechanical(linkage(), independent=CRANKS)


def motion() -> pinred.Trajectory:
    """Return a short motion."""
    return pinred.simulate(linkage(), duration=0.05, seed=1)


def captured() -> pinred.Capture:
    """Return the linkage with a body at its base."""
    rock = pinred.Model("rock").body("rock", mass=1.0, inertia=0.1)
    start = motion()
    at_base = pinred.Scene(
        system=pinred.load(rock, group="SE2", gravity=(0, 0, 0)),
        pose0=start.pose[-1],
        xi0=[0.1, 0.0, 0.2],
    )
    return pinred.capture(start, at_base, at="base", onto="rock")


def circle() -> pinred.Gait:
    """Return a small circle of the cranks."""
    return pinred.Gait.fourier([2.0, 1.0], [[0.1, 0.0]], [[0.0, 0.1]])


WHEELS = [pinred.Wheel(name) for name in ("base", "left_crank", "right_coupler")]
Call = Callable[[], object]
SUPPORTED: dict[str, Call] = {
    "simulate": motion,
    "simulate_many": lambda: pinred.simulate_many(
        linkage(), x0={"left_crank": np.array([2.0, 2.1])}, duration=0.05
    ),
    "flow": lambda: pinred.flow(linkage(), x0=linkage().closure.x, duration=0.05),  # type: ignore[union-attr]
    "compare": lambda: pinred.compare(motion()),
    "inspect": lambda: pinred.inspect(linkage()),
    "LoopReduction": lambda: pinred.LoopReduction(linkage()),
    "Connection.mechanical": connection,
    "Connection.viscous": lambda: pinred.Connection.viscous(linkage(), {"base": np.eye(6)}),
    "Connection.fluid": lambda: pinred.Connection.fluid(
        linkage(), 1.0, {"base": pinred.Ellipse(0.4, 0.1)}
    ),
    "Connection.kinematic": lambda: pinred.Connection.kinematic(linkage(), WHEELS),
    "phase": lambda: pinred.phase(connection(), circle()),
    "optimise_gait": lambda: pinred.optimise_gait(
        connection(),
        harmonics=1,
        starts=1,
        most=0.6,
        limits={"left_crank": (1.5, 2.5), "right_crank": (0.6, 1.5)},
    ),
    "reorient": lambda: pinred.reorient(
        connection(), 1e-4, limits={"left_crank": (1.7, 2.3), "right_crank": (0.7, 1.3)}
    ),
    "relative_equilibria": lambda: pinred.relative_equilibria(linkage(), momentum=0.5, starts=2),
    "linearise": lambda: pinred.linearise(motion()),
    "plot": lambda: pinred.plot(motion(), "shape"),
    "casimirs": lambda: pinred.poisson.casimirs(linkage()),
    "capture": lambda: captured(),
    "release": lambda: pinred.release(captured(), "rock"),
    "land": lambda: pinred.land(motion(), "base"),
    "chain": lambda: pinred.chain(motion(), pinred.land(motion(), "base", contact="flat")),
}
SLOW = ("optimise_gait", "reorient", "relative_equilibria")
REFUSED: dict[str, Call] = {
    "Reduction": lambda: pinred.Reduction(linkage()),
    "branches": lambda: pinred.branches(linkage(), momentum=[0.0, 1.0]),
    "FloatingArm": lambda: pinred.FloatingArm(linkage(), "left_tip"),
    "Connection.seen_from": lambda: connection().seen_from("left_crank"),
    "Connection.in_section": lambda: connection().in_section(lambda x: x),
    "Connection.in_chart": lambda: connection().in_chart([0.1, 0.2]),
    "mixed_connection": lambda: pinred.mixed_connection(linkage(), WHEELS[:1]),
    "casadi_functions": lambda: pinred.casadi_functions(linkage()),
    "phase_space": lambda: pinred.poisson.phase_space(linkage()),
    "rigid_body_phase": lambda: pinred.rigid_body_phase(linkage(), [0.1, 0.2, 0.3]),
    "parameters": lambda: pinred.simulate(
        linkage(), parameters={"left_coupler.placement": [0.6, 0, 0, 0, 0, 0]}, duration=0.1, seed=1
    ),
}


def names_in(head: str) -> list[str]:
    """Return the names in the first column of the table with a head."""
    text = PAGE.read_text("utf-8")
    table = text[text.index(head) :].split("\n\n")[0]
    rows = [line.split("|")[1] for line in table.splitlines()[2:]]
    return [name for row in rows for name in re.findall(r"`([\w.]+)`", row)]


def test_page_lists_exactly_the_functions_tested_here() -> None:
    """Neither the page nor this file has a name that the other lacks."""
    assert names_in("| with loops | what it does |") == [*SUPPORTED]
    assert names_in("| refused by name | remedy |") == [*REFUSED]


@pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.by_hand] * (n in SLOW)) for n in SUPPORTED]
)
@pytest.mark.sampled
def test_supported_functions_accept_loops(name: str) -> None:
    """Each function runs on a robot with loops; further tests compare its results."""
    assert SUPPORTED[name]() is not None


@pytest.mark.parametrize("name", REFUSED)
def test_other_functions_refuse_loops_by_name_with_a_remedy(name: str) -> None:
    """No function leaves a constraint out."""
    with pytest.raises(UnsupportedOperationError, match=r"tips.*\. [A-Z]") as error:
        REFUSED[name]()
    if name != "parameters":
        assert "closed loops are not supported here, and 'five_bar' has" in str(error.value)
        assert name in str(error.value)


def test_remedy_for_a_floating_arm_is_its_generalised_jacobian() -> None:
    """Differences of the hand's pose along closed shapes and horizontal motions give J_g G."""
    system, hand = linkage(), "right_tip"
    red = pinred.LoopReduction(system, independent=CRANKS)
    arm, u, h = pinred.FloatingArm(system.open_tree(), hand), np.array([2.0, 1.0]), 1e-5
    x = red.shape(u)
    J = arm.generalized_jacobian(x) @ red.at(x).G
    group, here = system.group, arm.hand_pose(x)
    for k, unit in enumerate(np.eye(2)):
        ends = []
        for sign in (1.0, -1.0):
            xi = -red.at(x).local_connection @ unit
            pose = group.exp(sign * h * xi)
            moved = here.actInv(arm.hand_pose(red.shape(u + sign * h * unit), pose=pose))
            ends.append(np.append(moved.translation[:2], np.arctan2(*moved.rotation[1::-1, 0])))
        twist = (ends[0] - ends[1]) / (2.0 * h)
        np.testing.assert_allclose(J[[0, 1, 5], k], twist, atol=1e-8)


def test_split_of_the_mass_matrix_has_independent_rates() -> None:
    """Its blocks are those of `at`, and its energy that of the tree."""
    red = pinred.LoopReduction(linkage(), independent=CRANKS)
    x, xi, udot = red.shape([2.0, 1.0]), np.array([0.1, -0.2, 0.3]), np.array([0.5, -0.7])
    split, here = red.split(x), red.at(x)
    for name in ("locked_inertia", "local_connection", "reduced_metric", "com"):
        np.testing.assert_allclose(getattr(split, name), getattr(here, name), atol=1e-13)
    tree = pinred.Reduction(linkage().open_tree())
    energy = tree.kinetic_energy(x, here.G @ udot, xi)
    assert split.kinetic_energy(udot, xi) == pytest.approx(energy, rel=1e-13)
    with pytest.raises(pinred.InputError, match="expected a closed shape of 'five_bar'"):
        red.split(np.zeros(4))
