"""Invalid scene files: one line names file, line, key, the value and the expected one."""

# ruff: noqa: E501 (a case a line)

from __future__ import annotations

import json
import math
import os
import re
import tomllib
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import pinred
from pinred.cli.command_line import main
from pinred.common.errors import InputError, LoadError, ModelError, PinredError, ShapeError
from pinred.planning.gait_file import GAIT_FILE
from pinred.scene.toml.reader import SCENE, scene_schema
from pinred.scene.toml.schema import LARGEST, Place, Table
from pinred.simulation.plan import plan_of
from pinred.simulation.simulate import explain_plan

ROOT = Path(__file__).parents[2]
EXAMPLES = sorted((ROOT / "examples").glob("*.toml"))
WORD = re.compile(r"[^\s,=\[\]{}]+")
NUMBER = re.compile(r"(?<![\w.])-?\d+(\.\d+)?")
KEYS = [
    *("robot", "load", "start", "run", "springs", "prescribed", "forces", "times", "samples"),
    *("kind", "name", "joint", "stiffness", "limit", "smooth", "kp", "spline", "values", "file"),
    *("bend", "columns", "end", "seed", "xi0", "momentum", "method", "step", "period", "function"),
]
VALIDATOR = jsonschema.Draft202012Validator(scene_schema())

PD = "[[forces]]\nkind = 'pd'\nreference = { bend = 0.1 }\nkp = 1\nkd = 1\n"
SPLINE = "{ spline = { times = [0, 1], values = [0, 1] } }"

# What is wrong with the structure: text after `robot = "falling_cat"`, and the message.
STRUCTURE = [
    ("gravitas = 1", "line 2: gravitas: unknown key \"gravitas\"; the keys here are robot, load, start, run"),
    ("forcs = []", "line 2: forcs: unknown key \"forcs\"; did you mean 'forces'? the keys here are robot, load,"),
    ("run = 3", "line 2: run: must be how to simulate, got 3"),
    ("[run]\ndurration = 1", "line 3: run.durration: unknown key \"durration\"; did you mean 'duration'?"),
    ("[run]\nduration = true", "line 3: run.duration: must be a number above 0, got true"),
    ("[run]\nduration = '2'", "run.duration: must be a number above 0, got the text \"2\""),
    ("[run]\nduration = 0", "run.duration: must be finite and a number above 0, got 0"),
    ("[run]\nduration = -1.5", "run.duration: must be finite and a number above 0, got -1.5"),
    ("[run]\nduration = 2020-01-01", "run.duration: must be a number above 0, got 2020-01-01"),
    ("[run]\nrtol = []", "run.rtol: must be a number above 0, got a list of 0"),
    ("[run]\ntimes = 2", "run.times: must be a list of entries, each a number, got 2"),
    ("[run]\ntimes = [0, '1']", "run.times[1]: must be a number, got the text \"1\""),
    ("[run]\ntimes = [0, 1]\nsamples = 3", "line 4: run.samples: give times or samples, not both"),
    ("[run]\nsamples = 1", "run.samples: must be a whole number from 2 to 1000000, got 1"),
    ("[run]\nsamples = 2.5", "run.samples: must be a whole number from 2, got 2.5"),
    ("[run]\nsamples = 99999999999", "run.samples: must be a whole number from 2 to 1000000"),
    ("[run]\nengine = 'steam'", "run.engine: unknown value \"steam\"; it can be compiled, pinocchio"),
    ("[run]\noutputs = 'shapes'", "did you mean 'shape'? it can be all, shape"),
    ("[run]\nmethod = 3", "run.method: must be an integrator as text, or an integrator {name = …}, got 3"),
    ("[run]\nmethod = ''", "run.method: must be an integrator as text, got no text"),
    ("[run]\nmethod = { name = 'RKMK' }", "run.method.name: unknown name \"RKMK\"; did you mean 'RKMK4'? the names are auto, AdaptiveGauss, DOP853, Gauss, RKMK4, Radau, Tsit5, Variational"),
    ("[run]\nmethod = { step = 0.1 }", "run.method: 'name' is missing; the names are auto, AdaptiveGauss, DOP853, Gauss, RKMK4, Radau, Tsit5, Variational"),
    ("[run]\nmethod = { name = 'RKMK4' }", "run.method: 'step' is missing: longest step [s]"),
    ("[run]\nmethod = { name = 'DOP853', step = 1 }", "run.method.step: unknown key"),
    ("[run]\nmethod = { name = 3 }", "run.method.name: must be text, got 3"),
    ("[start]\nseed = 1\nmomentum = 0", "start.seed: give momentum or seed, not both"),
    ("[start]\nxi0 = [0]\nmomentum = 0", "start.momentum: give xi0 or momentum, not both"),
    ("[start]\nq0 = [0]\nseed = 1", "start.seed: give q0 or seed, not both"),
    ("[start]\nx0 = [0]\nq0 = [1]", "start.q0: give x0 or q0, not both"),
    ("[start]\npose0 = [0]\nq0 = [1]", "start.q0: give pose0 or q0, not both"),
    ("[start]\nv0 = [0]\nxdot0 = [1]", "start.v0: give xdot0 or v0, not both"),
    ("[start]\nv0 = [0]\nxi0 = [1]", "start.v0: give xi0 or v0, not both"),
    ("[start]\nv0 = [0]\nmomentum = 0", "start.v0: give momentum or v0, not both"),
    ("[start]\nv0 = [0]\nseed = 0", "start.seed: give v0 or seed, not both"),
    ("[start]\nq0 = { bend = 1 }", "start.q0: must be a list of entries, each a number, got a table"),
    ("[start]\nseed = -1", "start.seed: must be a whole number from 0 to"),
    ("[start]\nseed = true", "start.seed: must be a whole number from 0, got true"),
    ("[start]\nx0 = 1", "start.x0: must be a list of entries, each a number, or a table {joint = a number, or a list of "
     "entries, each a number}, got 1"),
    ("[start]\nx0 = { bend = '1' }", "start.x0.bend: must be a number, or a list of entries, each a number, got the text \"1\""),
    ("[load]\ngroup = 'SO4'", "load.group: unknown value \"SO4\"; did you mean"),
    ("[load]\ngravity = [0, 0]", "load.gravity: must be a list of 3 entries, each a number, got a list of 2"),
    ("[load]\nlock = 'bend'", "load.lock: must be a list of entries, each the name of a joint, or a table"),
    ("[load]\nlock = [1]", "load.lock[0]: must be the name of a joint, got 1"),
    ("[springs]\nbend = 2", "springs.bend: must be a list of 2 entries, each a number, got 2"),
    ("[springs]\nbend = [2]", "springs.bend: must be a list of 2 entries, each a number, got a list of 1"),
    ("[prescribed]\nbend = true", "prescribed.bend: must be a number, or a formula in t, or a list of entries, each"),
    ("[prescribed]\nbend = {}", "prescribed.bend: must have one of the keys spline, linear, hold, fourier"),
    ("[prescribed]\nbend = { splin = {} }", "prescribed.bend.splin: unknown key \"splin\"; did you mean 'spline'?"),
    ("[prescribed]\nbend = { hold = {}, linear = {} }", "prescribed.bend: must have one of the keys"),
    ("[prescribed]\nbend = { spline = {} }", "prescribed.bend.spline: must have one of the keys times, file"),
    ("[prescribed]\nbend = { spline = { times = [0, 1] } }", "prescribed.bend.spline.times: 'times' requires 'values'"),
    ("[prescribed]\nbend = { spline = { file = 'a', times = [0], values = [0] } }", "prescribed.bend.spline: must have one of the keys times, file"),
    ("[prescribed]\nbend = { spline = { times = [0], values = [0], columns = [0, 1] } }", "'columns' requires 'file'"),
    ("[prescribed]\nbend = { spline = { times = [0, 1], values = [0, 1], end = 'free' } }", "prescribed.bend.spline.end: unknown value \"free\"; it can be natural,"),
    ("[prescribed]\nbend = { hold = { file = 'a', columns = [0, -1] } }", "prescribed.bend.hold.columns[1]: must be a whole number from 0"),
    ("[prescribed]\nbend = { fourier = { sines = [1] } }", "prescribed.bend.fourier: 'period' is missing: period [s]"),
    ("[prescribed]\nbend = { fourier = { period = 0 } }", "prescribed.bend.fourier.period: must be finite and a number above 0"),
    ("[prescribed]\nbend = ''", "prescribed.bend: must be a formula in t, got no text"),
    ("[forces]\nkind = 'pd'", "forces: must be a list of entries, each a force {kind = …}, got a table"),
    ("forces = [1]", "forces[0]: must be a force {kind = …}, got 1"),
    ("[[forces]]\nstiffness = 1", "forces[0]: 'kind' is missing; the kinds are spring, damper, friction, ball_spring,"),
    ("[[forces]]\nkind = 'sprig'", "forces[0].kind: unknown kind \"sprig\"; did you mean 'spring'? the kinds are"),
    ("[[forces]]\nkind = 'controller'", "forces[0].kind: a Controller is a Python function, and scene files are never executed"),
    ("[[forces]]\nkind = 1", "forces[0].kind: must be text, got 1; the kinds are"),
    ("[[forces]]\nkind = 'spring'\njoint = 'bend'", "forces[0]: 'stiffness' is missing: stiffness k [N·m/rad | N/m]"),
    ("[[forces]]\nkind = 'spring'\njoint = 'bend'\nstifness = 1", "forces[0].stifness: unknown key \"stifness\"; did you mean 'stiffness'? the keys here are kind, joint, stiffness, rest, to"),
    ("[[forces]]\nkind = 'spring'\njoint = ['bend']\nstiffness = 1", "forces[0].joint: must be the name of a joint, got a list of 1"),
    ("[[forces]]\nkind = 'potential'\nfunction = 1", "forces[0].function: must be a formula in x, got 1"),
    ("[[forces]]\nkind = 'torque'\nfunction = 'x[0]'", "forces[0].function: must be a table {joint = a number, or a formula in t, x, xdot and mu, or a signal table}"),
    ("[[forces]]\nkind = 'wrench'\nfunction = { x = 1 }", "forces[0].function: must be a list of entries, each"),
    (PD + "smooth = true", "forces[0].smooth: 'smooth' requires 'limit'"),
    (PD + "limit = 1\nsmooth = 1", "forces[0].smooth: must be true or false, got 1"),
    (PD + PD.replace("kp = 1", "kp = { bend = 'a' }"), "line 10: forces[1].kp.bend: must be a number, got the text \"a\""),
    (PD + "limit = [1]", "forces[0].limit: must be a number, or a table {joint = a number}, got a list of 1"),
]  # fmt: skip

# What only building the scene shows.
MEANING = [
    ("[run]\nduration = nan", InputError, "run.duration: must be finite and a number above 0, got nan"),
    ("[run]\ntimes = [0, inf]", InputError, "run.times[1]: must be finite and a number, got inf"),
    ("[run]\nduration = 1" + "0" * 400, InputError, "run.duration: must be finite and a number above 0, got a huge number"),
    ("[run]\ntimes = [1, 0]", InputError, "line 3: run.times: times must increase"),
    ("[run]\ntimes = [0, 3]\nduration = 2", InputError, "run.times: times must increase from 0 or later to the duration at most (2 s)"),
    ("[run]\ntimes = []", ShapeError, "run.times: times must be a vector"),
    ("[run]\nrtol = 1e-20", InputError, "run.rtol: rtol must be at least 1e-14"),
    ("[run]\nengine = 'pinocchio'\nmethod = { name = 'RKMK4', step = 0.1 }", InputError, "run.method: engine 'pinocchio' has an integrator of its own"),
    ("[run]\nmethod = 'RKMK4'", InputError, "line 3: run.method: method 'RKMK4' needs a step, as in RKMK4(0.01)"),
    ("[run]\nmethod = 'RKMK5(0.1)'", InputError, "run.method: unknown method 'RKMK5'; did you mean 'RKMK4'? the methods are AdaptiveGauss, DOP853,"),
    ("[run]\nmethod = 'print(1)'", InputError, "run.method: unknown method 'print'; the methods are AdaptiveGauss"),
    ("[run]\nmethod = 'DOP853'\nengine = 'pinocchio'", InputError, "run.method: engine 'pinocchio' has an integrator of its own"),
    ("[run]\nmethod = { name = 'Radau', rtol = 1e-6 }\natol = 1e-6", InputError, "line 4: run.atol: atol conflicts with the tolerances of the method Radau(rtol=1e-06"),
    ("[run]\nrtol = 1e-6\nmethod = 'DOP853(1e-8)'", InputError, "line 3: run.rtol: rtol conflicts with the tolerances of the method DOP853("),
    ("[start]\nq0 = [1, 2]", ShapeError, "start.q0: q0 must have shape (10,), got (2,)"),
    ("[start]\nq0 = [0, 0, 0, 0, 0, 0, 2, 0, 0, 0]", InputError, "start.q0: the quaternion of a pose of SE3 must have norm 1, got 2"),
    ("[start]\nv0 = [1]", ShapeError, "start.v0: v0 must have shape (9,), got (1,)"),
    ("[start]\nx0 = [1, 2]", ShapeError, "line 3: start.x0: expected 3 numbers: bend, sway, twist, got 2"),
    ("[start]\nx0 = { bends = 1 }", InputError, "start.x0.bends: unknown joint \"bends\"; did you mean 'bend'? the joints are bend, sway, twist"),
    ("[start]\nxi0 = [1, 2]", ShapeError, "start.xi0: expected 6 numbers: v1, v2, v3, ω1, ω2, ω3, got 2"),
    ("[start]\nxdot0 = [1e308, 1e308, 1e308]\nxi0 = [1e308, 0, 0, 1e308, 0, 0]", InputError, "the initial momentum or twist overflows"),
    ("[start]\nmomentum = 2", InputError, "start.momentum: must be a list of 6 numbers, or 0"),
    ("[start]\nmomentum = [1]", ShapeError, "start.momentum: expected 6 numbers: px, py, pz, Lx, Ly, Lz, got 1"),
    ("[start]\npose0 = [1, 2]", ShapeError, "start.pose0: a pose of SE3"),
    ("[load]\ngravity = [0, 0, -1e200]", InputError, "load: gravity must be below 1e+100 m/s²"),
    ("[load]\nlock = ['knee']", InputError, "load: lock: no joint 'knee'; the joints are"),
    ("[springs]\nbends = [1, 0]", InputError, "springs.bends: unknown joint \"bends\"; did you mean 'bend'?"),
    ("[prescribed]\nbends = 1", InputError, "prescribed.bends: unknown joint"),
    ("[prescribed]\nbend = '3*x'", InputError, "prescribed.bend: the expression cannot be used, column 3: x is not a name; 3*x; names: t; constants: pi, e; functions: sin,"),
    ("[prescribed]\nbend = '__import__(\"os\").system(\"true\")'", InputError, "prescribed.bend: the expression cannot be used, column 1: this is not a function"),
    ("[prescribed]\nbend = { spline = { times = [0, 0], values = [0, 1] } }", InputError, "prescribed.bend.spline: times of a Spline must increase strictly"),
    ("[prescribed]\nbend = { spline = { times = [0, 1], values = [0] } }", ShapeError, "prescribed.bend.spline: values of a Spline must have shape (2,)"),
    (f"[run]\nduration = 5\n[prescribed]\nbend = {SPLINE}", InputError, "line 5: prescribed.bend.spline: this Spline is defined from 0 to 1 s, but the scene goes from 0 to 5 s"),
    ("[prescribed]\nbend = { hold = { times = [0, 1], values = [0, 1] } }", InputError, "prescribed.bend.hold: prescribed['bend'] must have a continuous rate, but this Hold has a kink"),
    ("[[forces]]\nkind = 'spring'\njoint = 'knee'\nstiffness = 1", InputError, "forces[0].joint: unknown joint \"knee\"; the joints are bend, sway, twist"),
    ("[[forces]]\nkind = 'spring'\njoint = 'bend'\nto = 'swag'\nstiffness = 1", InputError, "forces[0].to: unknown joint \"swag\"; did you mean 'sway'?"),
    ("[[forces]]\nkind = 'damper'\njoint = 'bend'\nto = 'bend'\ncoefficient = 1", InputError, "forces[0]: damper bend–bend: both ends are the same joint"),
    ("[[forces]]\nkind = 'potential'\nfunction = 't*x[0]'", InputError, "forces[0].function: the expression cannot be used, column 1: t is not a name"),
    ("[[forces]]\nkind = 'potential'\nfunction = 'x[3]'", InputError, "forces[0].function: the expression cannot be used, column 3: x has no entry 3"),
    ("[[forces]]\nkind = 'torque'\nfunction = { bend = 'mu[6]' }", InputError, "forces[0].function.bend: the expression cannot be used, column 4: mu has no entry 6"),
    ("[[forces]]\nkind = 'torque'\nfunction = { knee = 1 }", InputError, "forces[0].function.knee: unknown joint"),
    ("[[forces]]\nkind = 'wrench'\nfunction = [1, 2]", InputError, "forces[0].function: must have 6 entries for SE3, got 2"),
    ("[[forces]]\nkind = 'wrench'\nfunction = [1, 2, 3, 4, 5, 'y']", InputError, "forces[0].function[5]: the expression cannot be used, column 1: y is not a name"),
    (PD + PD.replace("kp = 1", "kp = { shoulder = 1 }"), InputError, "forces[1].kp.shoulder: unknown joint \"shoulder\""),
    (PD + PD.replace("kp = 1", "kp = { sway = 1 }"), InputError, "forces[1]: kp of pd has no value for 'bend'"),
    (PD + "limit = 0", InputError, "forces[0]: the limit of pd at 'bend' must be finite and above zero"),
    (PD + "limit = { twist = 1 }", InputError, "forces[0]: the limit of pd has no value for 'bend'"),
    (PD.replace("pd", "computed_torque"), InputError, "forces[0]: computed torque has no reference for joint 'sway'"),
    (PD.replace("0.1", "{ hold = { times = [1], values = [0] } }"), InputError, "forces[0].reference.bend.hold: this Hold is defined from 1 to inf s"),
]  # fmt: skip


def message_of(folder: Path, text: str, kind: type[PinredError] = PinredError) -> str:
    """What a scene file with this text is refused with."""
    path = folder / "scene.toml"
    path.write_text(text, encoding="utf-8")
    assert main(["run", str(path), "--validate"]) == 2
    with pytest.raises(kind) as caught:
        pinred.load_scene(path)
    message = str(caught.value)
    assert message.startswith(f"{path}")
    assert "\n" not in message
    return message.removeprefix(f"{path}, ").removeprefix(f"{path}: ")


@pytest.mark.parametrize(("text", "words"), STRUCTURE)
@pytest.mark.sampled
def test_invalid_structure_is_refused_by_reader_and_schema(
    text: str, words: str, tmp_path: Path
) -> None:
    """The reader and the JSON Schema refuse the same documents."""
    text = f'robot = "falling_cat"\n{text}\n'
    assert words in message_of(tmp_path, text, InputError)
    document = as_json(text)
    assert list(VALIDATOR.iter_errors(document))


@pytest.mark.parametrize(("text", "kind", "words"), MEANING)
def test_invalid_scene_error_names_file_and_key(
    text: str, kind: type[PinredError], words: str, tmp_path: Path
) -> None:
    """A scene that cannot be simulated is refused as in Python."""
    assert words in message_of(tmp_path, f'robot = "falling_cat"\n{text}\n', kind)


@pytest.mark.parametrize(
    ("text", "kind", "words"),
    [
        ("", InputError, "'robot' is missing: a robot's name, or a URDF or MJCF file"),
        ("robot = 3", InputError, "line 1: robot: must be text, got 3"),
        ("robot = ''", InputError, "robot: must be text, got no text"),
        ("robot = 'falling_dog'", LoadError, "robot: unknown robot 'falling_dog'; did you mean"),
        ("robot = 'no.urdf'", InputError, "line 1: robot: no such file: "),
        ("robot = 'a/b'", InputError, "robot: no such file: "),
        (f"robot = '{'x' * 5000}/y'", InputError, "robot: no such file: "),
        ('robot = "a/\\u0000"', InputError, "robot: no such file: "),
        ("robot = 'scene.toml'", LoadError, "robot: "),
        (
            "robot = 'cartpole'\nload = { group = 'SE3' }",
            ModelError,
            "robot: group SE3 was requested, but the root joint",
        ),
        (
            "robot = 'cartpole'\nload = { lock = ['pole_pivot'] }",
            InputError,
            "has no default initial state",
        ),
        ("robot = [", LoadError, "at its end: not TOML: "),
        ("robot = 'cartpole'\nrobot = 'cartpole'", LoadError, "line 2, column "),
        ("robot = 'cartpole'\n[run]\nrtol = 1e-8\nrtol = 1e-9", LoadError, "line 4, column "),
        ("robot = 'cartpole'\n[run]\n[run]", LoadError, "line 3, column "),
        ("hello", LoadError, "line 1, column "),
        ("run = " + "[" * 5000, LoadError, "nested too deep"),
        ("a." * 60 + "b = 1", LoadError, "a key of more than 50 parts"),
        ("run = " + "1" * 5000, LoadError, "a number with thousands of digits"),
        ('"a b\\n" = 1\nrobot = "cartpole"', InputError, '"a b\\\\n": unknown key "a b\\\\n"'),
    ],
)
def test_invalid_robot_or_toml_error_names_the_file(
    text: str, kind: type[PinredError], words: str, tmp_path: Path
) -> None:
    """Robots that cannot be loaded, and files that are not TOML, are refused."""
    assert words.replace("\\\\", "\\") in message_of(tmp_path, text, kind)


def test_check_reports_gravity_that_breaks_the_symmetry(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """--validate includes errors that only the reduction detects."""
    path = tmp_path / "scene.toml"
    path.write_text("robot = 'double_spherical_pendulum'\nload = { gravity = [1, 0, 0] }")
    assert main(["run", str(path), "--validate"]) == 2
    assert "breaks the SO2 symmetry" in capsys.readouterr().err


def test_unreadable_file_raises_load_error(tmp_path: Path) -> None:
    """Folders, pipes, missing, binary and huge files raise LoadError; other types InputError."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "binary").write_bytes(b"robot = '\xff'")
    (tmp_path / "huge").write_bytes(b"#" * (LARGEST + 1))
    (tmp_path / "secret").write_text("robot = 'cartpole'")
    for name, words in (
        ("none.toml", "no such scene file"),
        (".", "no such scene file"),
        ("pipe", "no such scene file"),
        ("binary", "is not UTF-8 text, at byte 9"),
        ("huge", f"has more than {LARGEST} bytes"),
        ("a\0b", "scene file"),
        ("x" * 5000, "scene file"),
    ):
        with pytest.raises(LoadError, match=words):
            pinred.load_scene(tmp_path / name)
    with pytest.raises(InputError, match="path of a TOML file, got int"):
        pinred.load_scene(3)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("table", "columns", "words"),
    [
        ("", "", "is empty"),
        ("time,value\n", "", "no numbers below its header"),
        ("0,1\n1,x\n", "", 'line 2, column 1: must be a finite number, got the text "x"'),
        ("0,1\n1,nan\n", "", "line 2, column 1: must be a finite number"),
        ("0,1\n1,1e999\n", "", "line 2, column 1: must be a finite number"),
        ("0,1\n1,1_0\n", "", "line 2, column 1: must be a finite number"),
        ("0,1\n\n1\n", "", "line 3, column 1: there are only 1 columns"),
        ("0\n1\n", "", "has 1 columns, so column 1 (counted from 0) is missing"),
        ("0,1\n1,2\n", "['t', 1]", "there is no header with names"),
        ("time,v\n0,1\n", "['tim', 1]", "unknown column \"tim\"; did you mean 'time'?"),
        ("t,t\n0,1\n", "['t', 1]", 'has two columns the text "t"'),
        ("t,v\n0,'__import__'\n", "", "line 2, column 1: must be a finite number"),
        ('0,"1\n', "", "is not a csv file: "),
        ("1,1\n0,1\n", "", "times of a Linear must increase strictly"),
        ("0,1\n", "", "needs at least 2 entries"),
        ("".join(f"{k},0\n" for k in range(100_001)), "", "has 100001 entries, more than 100000"),
        ("0,1\n" * (LARGEST // 4 + 1), "", f"has more than {LARGEST} bytes"),
        (None, "", "no such csv file"),
    ],
)
def test_invalid_csv_error_names_file_line_and_column(
    table: str | None, columns: str, words: str, tmp_path: Path
) -> None:
    """A csv file with invalid content is refused."""
    if table is not None:
        (tmp_path / "t.csv").write_text(table, encoding="utf-8")
    chosen = f", columns = {columns}" if columns else ""
    text = (
        "robot = 'falling_cat'\n[[forces]]\nkind = 'torque'\n"
        f"function.bend.linear = {{ file = 't.csv'{chosen} }}\n"
    )
    message = message_of(tmp_path, text)
    assert message.startswith("line 4: forces[0].function.bend.linear")
    assert words in message


def test_binary_or_missing_csv_is_refused(tmp_path: Path) -> None:
    """The message says why the csv file cannot be read."""
    text = "robot = 'falling_cat'\n[prescribed]\nbend.spline.file = '{}'\n"
    (tmp_path / "binary.csv").write_bytes(b"0,\xff\n")
    assert "not UTF-8" in message_of(tmp_path, text.format("binary.csv"))
    assert "no such csv file" in message_of(tmp_path, text.format("../none.csv"))


def test_run_without_scene_prints_error_or_schema(capsys: pytest.CaptureFixture[str]) -> None:
    """Without a scene, only --schema works."""
    assert main(["run"]) == 2
    assert "the name of a TOML file" in capsys.readouterr().err
    assert main(["run", "--schema"]) == 0
    assert json.loads(capsys.readouterr().out) == pinred.scene_schema()


def as_json(text: str) -> Any:
    """A TOML text as what JSON holds; dates as objects of a type that no schema has."""
    return tomllib.loads(text)


def test_schema_is_valid_and_describes_every_key() -> None:
    """The schema follows draft 2020-12, and each key has a description."""
    jsonschema.Draft202012Validator.check_schema(scene_schema())

    def walk(schema: Any) -> None:
        if isinstance(schema, dict):
            for key in schema.get("properties", {}).values():
                assert key["description"]
            for part in schema.values():
                walk(part)
        elif isinstance(schema, list):
            for part in schema:
                walk(part)

    walk(scene_schema())


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_examples_validate_against_the_schema(path: Path) -> None:
    """Every example is valid."""
    VALIDATOR.validate(as_json(path.read_text(encoding="utf-8")))


SMALL = [path.read_text(encoding="utf-8") for path in EXAMPLES if "solo12" not in path.stem]
PIECES = st.one_of(
    st.sampled_from(
        [
            *("true", "nan", "-inf", "1e308", "-1e308", "5e-324", "0", "-1", "[]", "{}", "''"),
            *("'x'", "'t'", "\"x['bend']\"", "1e400", "9" * 30, "2020-01-01", "[[]]", "\n", "#"),
            *("'1/0'", "'1/t'", "'log(t)'", "'sqrt(x[0]-9)'", "= ", "[[forces]]\n", "[run]\n"),
        ]
    ),
    st.text(max_size=5),
    st.floats().map(repr),
    st.integers().map(str),
)


NUMBERS = st.one_of(
    st.sampled_from(["1e308", "-1e308", "1e154", "5e-324", "1e-160", "0", "-0.0", "nan", "inf"]),
    st.floats().map(repr),
    st.integers(-3, 10).map(str),
)


@st.composite
def mutated(draw: st.DrawFn) -> str:
    """A valid document with a few words, or any stretches, put wrong."""
    text: str = draw(st.sampled_from(SMALL))
    if draw(st.booleans()):  # one number another: most of these can be read
        number = draw(st.sampled_from(list(NUMBER.finditer(text))))
        return text[: number.start()] + draw(NUMBERS) + text[number.end() :]
    for _ in range(draw(st.integers(1, 3))):
        if draw(st.booleans()):
            words = [(m.start(), m.end()) for m in WORD.finditer(text)]
            first, last = draw(st.sampled_from(words))
        else:
            first = draw(st.integers(0, len(text)))
            last = min(len(text), first + draw(st.integers(0, 12)))
        text = text[:first] + draw(PIECES) + text[last:]
    return text


@pytest.mark.by_hand
@pytest.mark.slow
@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=mutated())
def test_mutated_file_raises_only_pinred_errors(
    text: str, tmp_path_factory: pytest.TempPathFactory
) -> None:
    """The message is one line."""
    folder = tmp_path_factory.getbasetemp()
    for name in ("heavy_top.urdf", "tabulated_torque.csv"):
        (folder / name).write_bytes((ROOT / "examples" / name).read_bytes())
    path = folder / "scene.toml"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    said = ""
    try:
        scene = pinred.load_scene(path)
    except PinredError as error:
        said = str(error)
    if said:
        assert said.startswith(str(path))
        assert "\n" not in said
    else:
        with suppress(PinredError), warnings.catch_warnings(action="ignore"):
            assert explain_plan(plan_of(scene))
        # What the numbers make of each other is said when somebody wants it.
        with suppress(PinredError):
            assert math.isfinite(scene.start.mu.sum())
            assert math.isfinite(scene.start.xi.sum())


VALUES = st.recursive(
    st.one_of(
        st.booleans(),
        st.integers(-3, 3),
        st.sampled_from([0.5, -1.5, "t", "bend", "all", "spring", "RKMK4", ""]),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.dictionaries(st.sampled_from(KEYS), inner, max_size=3),
    ),
    max_leaves=6,
)


@pytest.mark.slow
@settings(max_examples=200)
@given(st.sampled_from(EXAMPLES), st.data())
def test_reader_and_schema_agree_on_changed_documents(path: Path, data: st.DataObject) -> None:
    """Both accept or both refuse a document with one changed value."""
    document = as_json(path.read_text(encoding="utf-8"))
    at = document
    while True:
        keys = list(range(len(at))) if isinstance(at, list) else [*at, *KEYS]
        if not keys:
            break
        key = data.draw(st.sampled_from(keys))
        inside = at[key] if key in keys[: len(at)] else None
        if isinstance(inside, (list, dict)) and data.draw(st.booleans()):
            at = inside
            continue
        at[key] = data.draw(VALUES)
        break
    try:
        SCENE.read(document, Place("scene.toml"))
        read = True
    except InputError:
        read = False
    assert read == VALIDATOR.is_valid(document), document


@pytest.mark.parametrize("document", [SCENE, GAIT_FILE], ids=lambda table: table.words)
def test_every_key_in_a_wrong_table_says_where_it_belongs(document: Table) -> None:
    """Keys of the top level in tables, keys of tables at the top level and in other tables."""
    tables = {"": document}
    tables |= {n: k.node for n, k in document.keys.items() if isinstance(k.node, Table)}
    count = 0
    for key in {key for table in tables.values() for key in table.keys}:
        homes = [name for name, table in tables.items() if key in table.keys]
        for name in tables.keys() - homes:
            text = {"robot": "cartpole", **({name: {key: 1}} if name else {key: 1})}
            with pytest.raises(pinred.InputError) as refused:
                document.read(text, Place("f.toml"))
            places = [f"in the table [{home}]" for home in homes if home]
            if "" in homes:
                places.insert(0, "to the top level, above the first line with a [table]")
            at = f"{name}.{key}" if name else key
            assert str(refused.value) == f"f.toml: {at}: this key belongs {' or '.join(places)}"
            count += 1
    assert count > 60


def test_misplaced_key_is_named_with_its_line(tmp_path: Path) -> None:
    """The message of a file, for a flag that was written below a table."""
    text = "robot = 'falling_cat'\n[run]\nduration = 1\npassive = true\n"
    message = message_of(tmp_path, text, pinred.InputError)
    assert "line 4: run.passive: this key belongs to the top level, above the first li" in message
