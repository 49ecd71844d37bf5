"""Notebook cards: well-formed, escaped, without scripts, and with correct numbers."""

from __future__ import annotations

import re
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from trees import random_model

import pinred
from pinred.common import html as html_parts
from pinred.forces import Damper, PotentialEnergy
from pinred.laboratory.bench import Point, WorkPrecision
from pinred.signals import Constant

NASTY = "<script>alert('x')</script>&amp;\"<b>"
TAGS = {
    *("div", "strong", "table", "thead", "tbody", "tr", "th", "td", "details", "summary"),
}


class StrictPage(HTMLParser):
    """Parse HTML strictly: known tags closed in order, no attribute except styles."""

    def __init__(self, html: str) -> None:
        """Parse the text."""
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.text = ""
        self.tables: list[list[list[str]]] = []
        self.feed(html)
        self.close()
        assert self.open == [], f"not closed: {self.open}"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Check a tag; start a table, a row or a cell."""
        assert tag in TAGS, tag
        assert [name for name, _ in attrs] in ([], ["style"]), attrs
        for _, style in attrs:
            assert style is not None
            assert "url" not in style
            assert "background" not in style
        self.open.append(tag)
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")

    def handle_endtag(self, tag: str) -> None:
        """Close the last open tag."""
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        """Store text, also in the current cell."""
        self.text += data
        if self.open and "tr" in self.open:
            self.tables[-1][-1][-1] += data

    def numbers(self, k: int) -> np.ndarray[Any, np.dtype[np.float64]]:
        """Return the numbers of a table without its first row and column."""
        return np.array([[float(cell) for cell in cells[1:]] for cells in self.tables[k][1:]])


def card_of(value: Any) -> StrictPage:
    """Parse the notebook card of a value."""
    return StrictPage(value._repr_html_())


def test_system_card() -> None:
    """The joints with their types, and the mass by Pinocchio."""
    system = pinred.load("satellite_two_arms")
    card = card_of(system)
    (joints,) = card.tables
    assert joints[0] == ["joint", "kind", "unit"]
    assert [cells[0] for cells in joints[1:]] == list(system.model.names)[2:]
    assert all(cells[1:] == ["revolute", "rad"] for cells in joints[1:])
    mass = pin.computeTotalMass(system.model)
    assert f"group SE3 (r = 6) on joint 'root_joint', shape of 6 joints, {mass:g} kg" in card.text
    tree = pinred.System(random_model("SE2", 8, 0), name="tree")
    kinds = {"P": ["prismatic", "m"], "R": ["revolute", "rad"]}
    expected = [kinds[j.shortname().removeprefix("JointModel")[0]] for j in tree.model.joints[2:]]
    assert [cells[1:] for cells in card_of(tree).tables[0][1:]] == expected
    assert len({category for category, _ in expected}) == 2


def test_long_table_is_folded() -> None:
    """More than 12 joints are behind a line with their number."""
    assert "<details>" not in pinred.load("planar_chain5")._repr_html_()
    html = html_parts.table("joints", ["name", "value"], [(str(k), float(k)) for k in range(13)])
    assert html.startswith("<details><summary>joints (13 rows)</summary>")
    assert len(StrictPage(html).tables[0]) == 14


def test_reduction_card_in_closed_form() -> None:
    """I, A and M of coupled planar bodies."""
    system = pinred.load("coupled_planar")
    m1, m2, d, I1, I2 = 3.0, 1.0, 0.5, 0.5, 0.25
    m, delta = m1 + m2, (m1 + m2) * (I1 + I2) + m1 * m2 * d**2
    I = np.array([[m, 0, 0], [0, m, m2 * d], [0, m2 * d, I1 + I2 + m2 * d**2]])
    A = np.array([[0], [-I2 * m2 * d / delta], [I2 * m / delta]])
    M = np.array([[(I1 * I2 * m + I2 * m1 * m2 * d**2) / delta]])
    for value in (pinred.Reduction(system).at([0.3]), pinred.inspect(system, [0.3])):
        card = card_of(value)
        np.testing.assert_allclose(card.numbers(-3), I, rtol=1e-5, atol=0.0)
        np.testing.assert_allclose(card.numbers(-2), A, rtol=1e-5, atol=0.0)
        np.testing.assert_allclose(card.numbers(-1), M, rtol=1e-5, atol=0.0)
        assert "at x = (0.3)" in card.text
    assert card.tables[-3][0] == ["", "v1", "v2", "ω"]
    assert [cells[0] for cells in card.tables[-2]] == ["", "v1", "v2", "ω"]
    assert card.tables[-2][0] == ["", "hinge"]


def test_card_without_joints() -> None:
    """A rigid body has no connection, and the card says so."""
    card = card_of(pinred.inspect(pinred.load("rigid_body")))
    assert "local connection A: none, there are no joints" in card.text
    np.testing.assert_allclose(card.numbers(-1), np.diag([1.0, 2.0, 2.5]), rtol=1e-6)
    assert card_of(pinred.load("rigid_body")).tables == []


def test_reduction_card_without_potential() -> None:
    """The card says why there is no potential."""
    tilted = pinred.load("double_spherical_pendulum", gravity=(1.0, 0.0, -9.0))
    assert "gravity breaks the symmetry" in card_of(pinred.Reduction(tilted).at(np.zeros(3))).text


def test_trajectory_card() -> None:
    """Initial and final shape, energy by Pinocchio, rotation of the base, momentum."""
    system = pinred.load("falling_cat")
    traj = pinred.simulate(system, duration=1.0)
    card = card_of(traj)
    table_rows = np.column_stack([traj.x[0], traj.x[-1], traj.x.min(axis=0), traj.x.max(axis=0)])
    np.testing.assert_allclose(card.numbers(0), table_rows, rtol=1e-5)
    model, data = system.model, system.model.createData()
    kinetic = pin.computeKineticEnergy(model, data, traj.q[-1], traj.v[-1])
    energy = re.search(r"energy \[J\]: (\S+) → (\S+?)base", card.text)
    assert energy is not None
    assert float(energy[1]) == pytest.approx(kinetic, rel=1e-5)
    a, b = (pin.XYZQUATToSE3(q[:7]) for q in (traj.q[0], traj.q[-1]))
    turn = np.linalg.norm(pin.log3(a.rotation.T @ b.rotation))
    way = np.linalg.norm(b.translation - a.translation)
    assert f"turned by {turn:.6g} rad, moved by {way:.6g} m" in card.text
    units = "spatial momentum [N·s | N·m·s]"
    assert card.tables[1][0] == [units, "v1", "v2", "v3", "ω1", "ω2", "ω3"]
    pin.computeCentroidalMomentum(model, data, traj.q[0], traj.v[0])
    about_origin = data.hg.angular + np.cross(data.com[0], data.hg.linear)
    expected = np.concatenate([data.hg.linear, about_origin])
    np.testing.assert_allclose(card.numbers(1), [expected, expected], rtol=2e-5, atol=1e-9)


def test_trajectory_card_without_base() -> None:
    """Only requested outputs are shown."""
    card = card_of(pinred.simulate(pinred.load("falling_cat"), duration=0.5, outputs="shape"))
    assert len(card.tables) == 1
    assert "base" not in card.text


def test_report_card() -> None:
    """Every check with its bound; failures in words."""
    report = pinred.compare(pinred.simulate(pinred.load("elroys_beanie"), duration=1.0))
    card = card_of(report)
    table_rows = {cells[0]: cells[1:] for cells in card.tables[0][1:]}
    assert table_rows == {
        name: [f"{value:.2e}", f"{bound:.1e}", "ok"]
        for name, (value, bound) in report.checks.items()
    }
    assert card.text.endswith("verdict: PASSED")
    bad = card_of(replace(report, energy_drift=float("nan"), defect=1.0))
    words = {cells[0]: cells[-1] for cells in bad.tables[0][1:]}
    assert [name for name, word in words.items() if word == "FAILED"] == [
        "defect of a step [relative]",
        "energy drift [relative]",
    ]
    assert bad.text.endswith("verdict: FAILED")


def test_balance_cards() -> None:
    """Work equals the energy lost in a damper; momentum is Pinocchio's."""
    system = pinred.load("elroys_beanie")
    traj = pinred.simulate(system, duration=2.0, forces=Damper("beanie", 0.3))
    card = card_of(traj.energy_balance)
    table_rows = {cells[0]: float(cells[1]) for cells in card.tables[0][1:]}
    # The rate of the shape decays as exp(−c t/M), its energy as the square; M = 2/3.
    lost = 0.5 * (2 / 3) * traj.xdot[0, 0] ** 2 * (np.exp(-2 * 0.3 * 2.0 / (2 / 3)) - 1)
    assert table_rows["work of damper beanie"] == pytest.approx(lost, rel=1e-5)
    assert table_rows["energy at the end"] - table_rows["energy at the start"] == pytest.approx(
        lost, rel=1e-5
    )
    momentum = card_of(traj.momentum_balance)
    spin = 2.0 * 0.8 + 1.0 * (0.8 - 0.4)  # I1 and I2 times their own rates
    assert momentum.tables[0][0] == ["component", "start", "impulse", "end", "largest residual"]
    np.testing.assert_allclose(momentum.numbers(0)[0, :3], [spin, 0.0, spin], rtol=1e-6)


def test_trajectories_card() -> None:
    """Failed members are listed."""
    system = pinred.load("elroys_beanie")
    fine = pinred.simulate_many(system, seeds=[1, 2], duration=1.0)
    assert "2 of 201 times to 1 s, 0 failed" in card_of(fine).text
    wall = PotentialEnergy(lambda x: -(x[0] ** 4), name="wall")
    lost = pinred.simulate_many(
        system, x0=[[0.0], [2.0]], xdot0=[[0.0], [1.0]], duration=5.0, forces=wall
    )
    card = card_of(lost)
    (cells,) = card.tables[0][1:]
    assert cells[0] == "1"
    assert 0.0 < float(cells[1]) < 5.0
    assert cells[2] == lost.failures[0].reason


def test_scene_card() -> None:
    """Initial state, duration, and forces."""
    system = pinred.load("elroys_beanie")
    card = card_of(
        pinred.Scene(
            system=system,
            x0=[0.4],
            momentum=[0.6],
            duration=3.0,
            springs={"beanie": (2.0, 0.1)},
            forces=Damper("beanie", 0.3),
        )
    )
    start, acting = card.tables
    assert start == [["joint", "x", "rate"], ["beanie", "0.4", "0"]]
    assert "twist of the base: (0.2)" in card.text  # μ/I
    assert acting[1] == ["spring beanie", "(2.0, 0.1)"]
    assert acting[2][0] == "damper beanie"
    assert "0.3" in acting[2][1]
    assert "Scene of elroys_beanie: 3 s, 201 times" in card.text
    planned = pinred.Scene(system=system, duration=1.0, prescribed={"beanie": Constant(0.2)})
    assert card_of(planned).tables[1][1] == ["prescribed beanie", "Constant(level=0.2)"]


def test_work_precision_card() -> None:
    """Measurements, failures with reasons, and time at equal error."""
    result = WorkPrecision(
        problem="a <problem>",
        joints=2,
        duration=1.0,
        reference_error=1e-14,
        about={"one": "about it"},
        points=(
            Point("one", 1e-4, wall=1e-3, evaluations=50.0, shape=1e-4, rotation=0.0, position=0.0),
            Point("one", 1e-8, wall=4e-3, evaluations=99.0, shape=1e-8, rotation=0.0, position=0.0),
            Point("one", 1e-12, failure="too <many> steps"),
        ),
    )
    card = card_of(result)
    equal, measured = card.tables
    # On a line in logarithms: 1 ms at 1e-4, 4 ms at 1e-8, so 2 ms at 1e-6, and no way to 1e-9.
    cells = dict(equal[1:])
    assert float(cells["1e-06"]) == pytest.approx(2.0)
    assert cells["1e-09"] == "—"
    assert measured[1] == ["one", "1e-04", "1.0e-04", "1", "50", ""]
    assert measured[3][-1] == "too <many> steps"
    assert card.text.startswith("a <problem>: 2 joints, 1 s")


def test_names_are_escaped() -> None:
    """Names from files and users are shown as text."""
    system = pinred.load("elroys_beanie")
    model = system.model.copy()
    model.names[2] = NASTY
    nasty = replace(system, model=model, name=NASTY)
    force = Damper(NASTY, 0.3)
    traj = pinred.simulate(nasty, duration=0.5, forces=force)
    cards = [
        nasty._repr_html_(),
        traj.scene._repr_html_(),
        traj._repr_html_(),
        traj.energy_balance._repr_html_(),
        pinred.inspect(nasty)._repr_html_(),
        pinred.compare(traj)._repr_html_(),
    ]
    for html in cards:
        assert "script>" not in html
        assert "<b>" not in html
        assert NASTY in StrictPage(html).text


def test_round_off_in_matrix_is_shown_as_zero() -> None:
    """Entries of 1e-17 next to 1 are hidden, a matrix of small numbers is not."""
    html = html_parts.matrix("I", np.array([[1.0, 3e-17], [-2e-18, 2.0]]), "ab", "cd")
    assert np.array_equal(StrictPage(html).numbers(0), [[1.0, 0.0], [0.0, 2.0]])
    html = html_parts.matrix("I", np.array([[1e-9, 3e-17]]), "a", "cd")
    assert StrictPage(html).numbers(0)[0, 1] == 3e-17


def test_cards_of_gaits_and_reductions_have_their_numbers() -> None:
    """Ranges of the joints of a gait; the reduction of a robot at rest."""
    gait = pinred.Gait.fourier([0.3, 0.0], [[0.5, 0.0]], [[0.0, 0.25]], period=2.0, turns=[0, 1])
    page = StrictPage(gait._repr_html_())
    assert "Fourier series of 2 joints with period 2 s" in page.text
    assert page.tables[0][1][1:] == ["-0.2", "0.8", "0"]
    assert page.tables[0][2][3] == "1"
    strokes = pinred.Gait.waypoints([[0.0], [1.0], [0.5]])
    assert "3 arcs of 1 joints" in StrictPage(strokes._repr_html_()).text
    system = pinred.load("coupled_planar")
    page = StrictPage(pinred.Reduction(system)._repr_html_())
    assert "Reduction of coupled_planar" in page.text
    inertia = pinred.Reduction(system).locked_inertia([0.0])
    assert page.tables[0][1][1] == f"{inertia[0, 0]:.6g}"
