"""Sweeps of scenes with joint stops: outputs of impacts, stores, scene files and the command."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.cli.command_line import main
from pinred.scene.scene import Scene
from pinred.sweeps import sweep as sweep_module
from pinred.sweeps.sweep_job import SweepJob

CAT = pinred.load("falling_cat")
STOPS: dict[str, Any] = {
    "bend": (-0.6, 0.6),
    "sway": pinred.Stop(-0.5, 0.5, restitution=0.6),
}


def slide_scene(**options: Any) -> Scene:
    """Return a scene of 3 kg and 1 kg on a line, 0.5 m from a stop, at 1 m/s."""
    model = pin.Model()
    model.name = "slide"
    model.gravity.setZero()
    for k, mass in enumerate((3.0, 1.0)):
        i = model.addJoint(k, pin.JointModelPX(), pin.SE3.Identity(), ("base", "slide")[k])
        inertia = pin.Inertia(mass, np.zeros(3), 0.1 * np.eye(3))
        model.appendBodyToJoint(i, inertia, pin.SE3.Identity())
    start: dict[str, Any] = {"x0": [0.5], "xdot0": [-1.0], "xi0": [0.0], "duration": 1.0}
    return Scene(
        system=pinred.load(model), **(start | {"stops": {"slide": (0.0, 9.0, 0.5)}} | options)
    )


@pytest.mark.filterwarnings("ignore::pinred.RejectedWarning")
def test_outputs_of_impacts_have_the_closed_form() -> None:
    """A slide of 0.75 kg loses ½ m (1 − e²) v² at its stop, unless it never arrives."""
    vary = {"xdot0.slide": [-1.0, -2.0, -0.1], "slide.stop.restitution": [0.5, 1.0, 1.5]}
    outputs = ["impacts", "impacts.slide", "first_impact", "energy_lost", "energy_lost.slide"]
    result = pinred.sweep(slide_scene(), vary, outputs=outputs)
    v = np.repeat([1.0, 2.0, 0.1], 3)
    e = np.tile([0.5, 1.0, np.nan], 3)
    hits = np.where(np.isnan(e), np.nan, v > 0.4)
    for name in ("impacts", "impacts.slide"):
        np.testing.assert_array_equal(result[name], hits)
    expected = np.where(hits == 1.0, 0.5 / v, np.nan)
    np.testing.assert_allclose(result["first_impact"], expected, rtol=1e-12)
    for name in ("energy_lost", "energy_lost.slide"):
        lost = hits * 0.375 * (1.0 - e**2) * v**2
        np.testing.assert_allclose(result[name], lost, rtol=1e-12, atol=1e-13)
    assert [result[name].attrs["units"] for name in outputs] == ["1", "1", "s", "J", "J"]
    assert [failure.member for failure in result.failures] == [2, 5, 8]
    assert result["slide.stop.restitution"].attrs["units"] == "1"


def test_points_have_the_bits_of_simulate() -> None:
    """Stored numbers, single points and simulations of the same scene agree bit for bit."""
    scene = Scene(system=CAT, xdot0=[3.0, -2.0, 1.0], duration=0.5, stops=STOPS)
    vary = {"front.mass": [4.0, 6.0], "bend.stop.upper": [0.3, 0.5]}
    result = pinred.sweep(scene, vary, outputs=["x", "impacts"])
    for k, (mass, upper) in enumerate([(4.0, 0.3), (4.0, 0.5), (6.0, 0.3), (6.0, 0.5)]):
        alone = pinred.simulate(
            scene, parameters={"front.mass": mass},
            stops={"bend": (-0.6, upper), "sway": STOPS["sway"]},
        )  # fmt: skip
        np.testing.assert_array_equal(result["x"].values[k], alone.x[-1])
        np.testing.assert_array_equal(result.point(k).x, alone.x)
        np.testing.assert_array_equal(result.point(k).impacts.t, alone.impacts.t)
        assert result["impacts"].values[k] == len(alone.impacts.times)
    assert result["bend.stop.upper"].attrs["units"] == "rad"


@pytest.mark.by_hand("stops1", "stops2", "None")
@pytest.mark.parametrize(
    "stops",
    [
        None,
        {"slide": (0.0, 9.0)},
        {"slide": (0.0, 9.0, 0.6)},
        {"slide": (0.1, 9.0, 0.5)},
        {"slide": pinred.Stop(0.0, 9.0, 0.5, rest_rate=1e-5)},
    ],
)
def test_store_of_other_stops_is_refused(tmp_path: Path, stops: Any) -> None:
    """A store is continued only with the stops that it was written for."""
    vary, store = {"xdot0.slide": [-1.0, -2.0]}, tmp_path / "s.zarr"
    first = pinred.sweep(slide_scene(), vary, outputs=["x"], store=store)
    again = pinred.sweep(slide_scene(), vary, outputs=["x"], store=store)
    np.testing.assert_array_equal(first["x"], again["x"])
    with pytest.raises(pinred.InputError, match=r"another scene: .*joint stops"):
        pinred.sweep(slide_scene(stops=stops), vary, outputs=["x"], store=store)


def test_interrupted_sweep_continues_with_the_same_numbers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Blocks that are stored are not computed again, and all numbers are those of one run."""
    vary = {"xdot0.slide": [-1.0, -2.0, -3.0, -4.0]}
    options: dict[str, Any] = {"outputs": ["x", "impacts", "first_impact"], "block": 1}
    whole = pinred.sweep(slide_scene(), vary, **options)
    compute = SweepJob.compute
    computed: list[int] = []

    def interrupted(self: Any, index: int, *args: Any) -> Any:
        if index == 2 and len(computed) == 2:
            raise KeyboardInterrupt
        computed.append(index)
        return compute(self, index, *args)

    monkeypatch.setattr(SweepJob, "compute", interrupted)
    with pytest.raises(KeyboardInterrupt):
        pinred.sweep(slide_scene(), vary, store=tmp_path / "s.zarr", **options)
    computed.append(-1)
    result = pinred.sweep(slide_scene(), vary, store=tmp_path / "s.zarr", **options)
    assert computed == [0, 1, -1, 2, 3]
    for name in options["outputs"]:
        np.testing.assert_array_equal(result[name], whole[name])


def test_worker_computes_the_numbers_of_this_process() -> None:
    """The job of a worker is a pickle, whose scene keeps its stops."""
    scene = Scene(system=CAT, xdot0=[3.0, -2.0, 1.0], duration=0.5, stops=STOPS)
    job = sweep_module._job(
        scene, {"sway.stop.restitution": [0.2, 0.8]}, None, None, 0, ["x", "energy_lost"], 2
    )
    here, there = job.compute(0, None), pickle.loads(pickle.dumps(job)).compute(0, None)
    for name, values in here.outputs.items():
        np.testing.assert_array_equal(values, there.outputs[name])
    assert here.outputs["energy_lost"][0] != here.outputs["energy_lost"][1]


@pytest.mark.parametrize(
    ("scene", "vary", "outputs", "message"),
    [
        ({"stops": None}, {"xdot0.slide": [1.0]}, ["impacts"], "'impacts': expected a scene with"),
        ({}, {"xdot0.slide": [1.0]}, ["impacts.slid"], "did you mean 'slide'"),
        ({"stops": None}, {"slide.stop.lower": [0.1]}, ["x"], "got stops of no joint"),
        ({}, {"slide.stop.lowest": [0.1]}, ["x"], "got 'lowest'; did you mean 'lower'"),
        ({"method": "Gauss(0.01, 8)"}, {"xdot0.slide": [1.0]}, ["x"], "none with method Gauss8"),
    ],
)
def test_refusals_of_sweeps_have_a_remedy(
    scene: dict[str, Any], vary: dict[str, Any], outputs: list[str], message: str
) -> None:
    """What does not act together with stops in sweeps is refused by name."""
    with pytest.raises(pinred.InputError, match=message):
        pinred.sweep(slide_scene(**scene), vary, outputs=outputs)


TEXT = """
robot = "falling_cat"
[start]
xdot0 = [3.0, -2.0, 1.0]
[run]
duration = 0.5
[stops]
bend = [-0.6, 0.6]
sway = {lower = -0.5, upper = 0.5, restitution = 0.6}
[sweep]
outputs = ["impacts", "first_impact", "energy_lost", "x"]
store = "s.zarr"
[sweep.vary]
"xdot0.bend" = [1.0, 3.0]
sway.stop.restitution = [0.0, 0.6]
"""


def test_command_sweeps_a_file_with_stops(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A file with [stops] and [sweep] gives the numbers of Python."""
    file = tmp_path / "scene.toml"
    file.write_text(TEXT, "utf-8")
    assert main(["sweep", str(file)]) == 0
    assert "energy_lost [J]: " in capsys.readouterr().out
    scene = Scene(system=CAT, xdot0=[3.0, -2.0, 1.0], duration=0.5, stops=STOPS)
    vary = {"xdot0.bend": [1.0, 3.0], "sway.stop.restitution": [0.0, 0.6]}
    expected = pinred.sweep(scene, vary, outputs=["impacts", "first_impact", "energy_lost", "x"])
    result = pinred.open_sweep(tmp_path / "s.zarr")
    for name in expected.data_vars:
        np.testing.assert_array_equal(result[name], expected[name])
    assert float(expected["impacts"].sum()) >= 4


def test_validation_of_a_file_refuses_what_the_run_would_refuse(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`pinred run --validate` has the errors of the run without running it."""
    file = tmp_path / "scene.toml"
    line = 'method = "Gauss(0.01, 8)"'
    file.write_text(TEXT.replace("duration = 0.5", f"duration = 0.5\n{line}"), "utf-8")
    assert main(["run", str(file), "--validate"]) == 2
    assert "stops: expected none with method Gauss8" in capsys.readouterr().err
    for line in ("check = true", 'checkpoint = "run.ckpt"', ""):
        file.write_text(TEXT.replace("duration = 0.5", f"duration = 0.5\n{line}"), "utf-8")
        assert main(["run", str(file), "--validate"]) == 0
