"""Units of costs and merits, by the kind of connection."""

from __future__ import annotations

from dataclasses import replace

import pytest

import pinred
from pinred.planning.optimisation.gait_search import cost_unit, merit_name
from pinred.planning.optimisation.objective import COSTS, CostKind


def drag() -> pinred.Connection:
    """Return a connection of drag."""
    rods = pinred.load("three_rods")
    links = ("middle", "rear", "front")
    return pinred.Connection.viscous(rods, dict.fromkeys(links, pinred.Rod(1.0, 2.0, 1.0)))


def test_costs_have_the_units_of_their_metric() -> None:
    """The metric of momenta measures an energy, that of drag a power."""
    rods = pinred.Connection.mechanical(pinred.load("three_rods"))
    assert [cost_unit(rods, kind) for kind in COSTS] == [
        "m √kg", "(N m)² s", "W² s", "W", "s",
    ]  # fmt: skip
    assert [cost_unit(drag(), kind) for kind in COSTS] == [
        "√(J s)", "(N m)² s", "W² s", "W/s", "s",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("cost", "name"),
    [
        ("length", ("rotation / length", "rad/(m √kg)")),
        ("torque", ("rotation / √torque", "rad/√((N m)² s)")),
        ("power", ("rotation / ⁴√power", "rad/⁴√(W² s)")),
        ("time", ("rotation / time", "rad/s")),
        (None, ("rotation", "rad")),
    ],
)
@pytest.mark.sampled
def test_merit_name_states_root_and_unit(
    three_rods_best: pinred.BestGait, cost: CostKind | None, name: tuple[str, str]
) -> None:
    """The root of the cost appears in the name and in the unit."""
    task = replace(three_rods_best.task, cost=cost)
    assert merit_name(task) == name
    assert merit_name(replace(task, most=1.0)) == ("rotation", "rad")


@pytest.fixture(scope="module")
def three_rods_best() -> pinred.BestGait:
    """Return a best gait of three rods."""
    rods = pinred.Connection.mechanical(pinred.load("three_rods"))
    return pinred.optimise_gait(rods, harmonics=1, starts=1)


def test_texts_state_what_plans_do_not_consider(three_rods_best: pinred.BestGait) -> None:
    """Speeds, efforts and collisions are not considered; the title of the figure has the phase."""
    assert "collisions between links" in str(three_rods_best)
    plan = pinred.reorient(pinred.load("three_rods"), 0.1)
    assert "velocity and effort limits of the file" in str(plan)
    angle = f"{abs(three_rods_best.phase.screw.angle) * 180 / 3.141592653589793:.4g}°"
    figure = pinred.plot(three_rods_best, "loop")
    title = figure.get_suptitle()
    assert angle in title
    assert f"a cycle, rotation / length = {three_rods_best.merit:.5g} rad/(m √kg)" in title
    assert "turns by 5.73° in 1 cycle, " in pinred.plot(plan, "loop").get_suptitle()
