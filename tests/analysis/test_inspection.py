"""Flatness and Casimirs of inspect, against closed forms."""

from __future__ import annotations

import pytest

import pinred


@pytest.mark.parametrize(
    ("robot", "flat", "casimirs"),
    [
        ("elroys_beanie", True, ("L",)),
        ("coupled_planar", True, ("P1² + P2²",)),  # B = 0 with one joint
        ("planar_chain5", False, ("P1² + P2²",)),
        ("falling_cat", False, ("P1² + P2² + P3²", "P1 L1 + P2 L2 + P3 L3")),
        ("cartpole", True, ("P",)),
        ("upright_drone", False, ("P3", "P1² + P2²")),
    ],
)
def test_flatness_and_casimirs_of_bundled_robots(
    robot: str, flat: bool, casimirs: tuple[str, ...]
) -> None:
    """Bundled robots have known flatness and Casimirs."""
    inspection = pinred.inspect(pinred.load(robot))
    assert (inspection.flat, inspection.casimirs) == (flat, casimirs)
    assert f"connection  {'flat' if flat else 'curved'}" in str(inspection)
    assert ", ".join(casimirs) in str(inspection)
    assert "Casimir" in inspection._repr_html_()


def test_coaxial_rotors_are_flat() -> None:
    """Two rotors about the axis of a hub commute: B = 0 with two joints and A ≠ 0."""
    import numpy as np
    import pinocchio as pin

    model = pin.Model()
    hub = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "hub")
    body = pin.Inertia(1.0, np.zeros(3), np.diag([0.1, 0.2, 0.3]))
    model.appendBodyToJoint(hub, body, pin.SE3.Identity())
    for name in ("one", "two"):
        wheel = model.addJoint(hub, pin.JointModelRZ(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(wheel, body, pin.SE3.Identity())
    assert pinred.inspect(pinred.load(model)).flat


def test_pivot_under_gravity_has_semidirect_casimirs() -> None:
    """The Casimirs are those of the semidirect product."""
    system = pinred.load("coupled_spatial", group="SO3", gravity=(0.0, 0.0, -9.81))
    assert pinred.inspect(system).casimirs == (
        "L1 Γ1 + L2 Γ2 + L3 Γ3",
        "Γ1² + Γ2² + Γ3²",
    )
