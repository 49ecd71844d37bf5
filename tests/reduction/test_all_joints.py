"""Placements of the joints and links of a tree as expressions, against Pinocchio's kinematics."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
from trees import placement, random_model

import pinred
from pinred.lie import GROUPS
from pinred.reduction.tree.all_joints import height


@pytest.mark.by_hand("SO2", "SO3", "RxSE2")
@pytest.mark.parametrize("group", GROUPS)
def test_heights_of_links_are_pinocchios(group: str) -> None:
    """Frames on hinges, slides and balls, with the gravity of the model and without any."""
    rng = np.random.default_rng(5)
    for gravity in (np.zeros(3), np.array([1.0, -2.0, 3.0])):
        model = random_model(group, 8, 1, armature=False, balls=0.3)
        names = [f"link{i}" for i in range(1, model.njoints)]
        for i, name in enumerate(names, start=1):
            frame = pin.Frame(name, i, 0, placement(rng), pin.FrameType.BODY)
            model.addFrame(frame)
        model.gravity.linear = gravity
        system = pinred.load(model)
        kinds = {joint.kind.units for joint in system.space.joints}
        assert ("m",) in kinds
        assert len(kinds) > 1
        up = -gravity / np.linalg.norm(gravity) if gravity.any() else np.array([0.0, 0.0, 1.0])
        pose = system.group.exp(rng.uniform(-1.0, 1.0, system.r))
        x = system.space.random(rng, 2.0)
        data = system.model.createData()
        pin.framesForwardKinematics(system.model, data, system.q(pose, x))
        g, y = ca.SX.sym("g", system.group.size), ca.SX.sym("x", system.nx)
        heights = ca.vertcat(*(height(system, g, y, name) for name in names))
        computed = np.asarray(ca.Function("heights", [g, y], [heights])(pose, x)).ravel()
        expected = [up @ data.oMf[system.model.getFrameId(name)].translation for name in names]
        np.testing.assert_allclose(computed, expected, atol=1e-12)
