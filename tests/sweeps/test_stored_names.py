"""Names and digests in stores: pickles name classes by their modules, which must not move.

If a class has to move, read its former name in `pinred.sweeps.sweep_job`.
"""

from __future__ import annotations

import pickle
from hashlib import sha256
from importlib import import_module
from io import BytesIO
from typing import Any

import pytest

import pinred
from pinred.kernels.build import model_bytes
from pinred.sweeps.sweep_job import StoredScene
from pinred.sweeps.sweep_outputs import Measure

STORED = {
    "pinred.common.argument_kinds": "Default",
    "pinred.common.parameter": "Parameter VectorParameter",
    "pinred.forces.controller": "Controller",
    "pinred.forces.force": "Limit",
    "pinred.forces.kinds": "BallLimit BallPD PotentialEnergy Torque Wrench",
    "pinred.forces.signals.attitude_signal": "Attitude",
    "pinred.forces.signals.signal": "Constant Expression Fourier Hold Linear Spline",
    "pinred.forces.tracking": "ComputedTorque PD",
    "pinred.integrators.methods.method": (
        "AdaptiveGauss DOP853 Gauss RKMK4 Radau Tsit5 Variational"
    ),
    "pinred.lie.groups": "_R _RxSE2 _SE2 _SE3 _SO2 _SO3",
    "pinred.scene.event": "Event",
    "pinred.scene.scene": "Scene _scene_of",
    "pinred.sweeps.distributions": "Grid LogUniform Normal PointSequence Uniform Values",
    "pinred.sweeps.sweep_job": "SweepJob",
    "pinred.sweeps.varied_numbers": "VariedNumber VariedScene",
    "pinred.system.coordinates": "CoordinateMap InitialState PlacedJoint ShapeSpace",
    "pinred.system.joints": "_named",
    "pinred.system.hinge_triples": "HingeTriple",
    "pinred.system.locked_joints": "LockedJoints",
    "pinred.system.loops.loop": "Loop",
    "pinred.system.loops.kinematics": "Closure",
    "pinred.system.passive": "BallSpring Damper Friction Spring",
    "pinred.system.robot_file_contents": "Actuator Contents LeftOut Origin",
    "pinred.system.find_robot_files": "Visuals",
    "pinred.system.system": "System",
}

FORMER = {
    "pinred.forces.ball_control": "BallLimit BallPD",
    "pinred.forces.signals.formulas": "Constant Expression Fourier",
    "pinred.forces.signals.tabulated": "Hold Linear Spline",
    "pinred.forces.wrench": "Wrench",
    "pinred.lie.planar_groups": "_R _SE2 _SO2",
    "pinred.lie.r_se2": "_RxSE2",
    "pinred.lie.spatial_groups": "_SE3 _SO3",
    "pinred.integrators.methods.explicit_methods": "DOP853 RKMK4 Tsit5",
    "pinred.integrators.methods.implicit_methods": "AdaptiveGauss Gauss Radau Variational",
    "pinred.common.default_marker": "Default",
    "pinred.sweeps.samplers": "PointSequence",
    "pinred.system.actuator": "Actuator",
    "pinred.system.ball_forces": "BallSpring",
    "pinred.system.elementary_joints": "_named",
    "pinred.system.loops.looped_system": "Closure",
    "pinred.system.shape_space": "PlacedJoint ShapeSpace",
    "pinred.system.robot_files": "Visuals",
    "pinred.system.visuals": "Visuals",
}


@pytest.mark.parametrize("module", STORED)
def test_stored_class_is_found_under_its_name(module: str) -> None:
    """A pickle of an earlier version finds the class, and a new pickle has the same name."""
    for name in STORED[module].split():
        kind = getattr(import_module(module), name)
        assert (kind.__module__, kind.__qualname__) == (module, name)


@pytest.mark.parametrize("module", FORMER)
def test_stored_class_is_found_under_its_former_name(module: str) -> None:
    """Stores of earlier versions name classes by the modules from which these have moved."""
    for name in FORMER[module].split():
        kind = StoredScene(BytesIO(f"c{module}\n{name}\n.".encode())).load()
        assert (kind.__module__, kind.__qualname__) != (module, name)
        assert name in STORED[kind.__module__].split()


@pytest.mark.parametrize("robot", ["falling_cat", "falling_cat_ball", "elroys_beanie", "four_bar"])
def test_stored_robot_names_only_listed_classes(robot: str) -> None:
    """The list above is complete for robots of all kinds."""
    named = set()

    class Reader(pickle.Unpickler):
        def find_class(self, module: str, name: str) -> Any:
            named.add((module, name))
            return super().find_class(module, name)

    Reader(BytesIO(pickle.dumps(pinred.load(robot)))).load()
    own = {(module, name) for module, name in named if module.startswith("pinred.")}
    assert own <= {(module, name) for module in STORED for name in STORED[module].split()}
    assert ("pinred.system.system", "System") in own


def test_robot_with_loop_has_its_former_digest() -> None:
    """Otherwise earlier stores of its sweeps belong to another robot, and do not continue."""
    digest = sha256(model_bytes(pinred.load("four_bar"))).hexdigest()
    assert digest == "1ebe37fb6418742a914c87f78c2ba8730d2177f25f008c6c8fdae94e900da22f"


def test_robot_with_composite_root_has_one_digest() -> None:
    """Pinocchio leaves the axes in new data of a composite joint uninitialised."""
    drone = pinred.load("upright_drone")
    assert len({model_bytes(drone) for _ in range(5)}) == 1


def test_measure_has_its_former_digest() -> None:
    """The joint of impacts came later; measures without one are pickled as before."""
    turn = Measure("turn", None)
    digest = sha256(pickle.dumps(turn, protocol=4)).hexdigest()
    assert digest == "386b297a151f538721bbf58f65de1bd18c446f7059d14a22319db80d7975277b"
    of_joint = Measure("impacts", None, joint="hip")
    assert [pickle.loads(pickle.dumps(measure)) for measure in (turn, of_joint)] == [turn, of_joint]
