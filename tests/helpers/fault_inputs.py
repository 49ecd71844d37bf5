"""Random invalid inputs, by kind. Each function generates an input and passes it to pinred.

It returns "" if the input was accepted and the result is sound, or a description of the unsound
result. Exceptions propagate.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import pinred
from pinred.cli.command_line import main as command
from pinred.scene.toml.reader import read_scene_file
from pinred.simulation.read_recording import read_recording
from pinred.system.find_robot_files import bundled_folder

Rng = np.random.Generator

_NUMBER = re.compile(rb"-?\d+\.?\d*(?:[eE][+-]?\d+)?")
_WORDS = [b"nan", b"inf", b"-1", b"0", b"1e300", b"-1e-320", b"1e999", b"", b"x", b"0x10", b"1,2"]
_BYTES = [b"<", b">", b'"', b"\0", b"\xff", b"&", b"]]>", b"<!--", b"[", b"=", b"\n", b"'", b"{"]
_ROBOTS = ("elroy_beanie", "falling_cat", "rigid_body", "double_spherical_pendulum")

_MJCF = b"""<mujoco model="m"><compiler angle="radian"/><option timestep="0.01"/>
<default><joint damping="0.1"/></default><worldbody><body name="base" pos="0 0 1"><freejoint/>
<inertial pos="0.1 0 0" mass="2" diaginertia="1 2 2.5"/><geom type="box" size=".1 .2 .3" mass="1"/>
<body name="arm" pos="0.1 0.2 0" euler="0.1 0 0"><joint name="hinge" axis="0 1 1" armature="0.3"
stiffness="2" springref="0.1"/><inertial pos="0.1 0 0" mass="1" diaginertia="1 1 1"/>
<replicate count="2" offset="0.1 0 0"><geom type="sphere" size="0.1" mass="0.1"/></replicate></body>
</body></worldbody><keyframe><key name="k" qpos="0 0 1 1 0 0 0 0.2"/></keyframe></mujoco>"""

_SCENE = b"""robot = "falling_cat"
[load]
gravity = [0.0, 0.0, 0.0]
[start]
x0 = { bend = 0.3, sway = 0.1 }
xdot0 = [0.1, 0.2, 0.0]
momentum = 0
[run]
duration = 0.1
samples = 11
method = { name = "DOP853", rtol = 1e-11, atol = 1e-13 }
[[forces]]
kind = "torque"
name = "pump"
function = { sway = "0.1*sin(t)*tanh(2*xdot['bend'])" }
limit = 0.3
smooth = true
[springs]
bend = [2.0, 0.1]
[prescribed]
twist = { fourier = { cosines = [-0.4, 0.8, -0.4], period = 0.6 } }
"""

_PLANNED = b"""robot = "falling_cat"
[run]
duration = 0.1
[prescribed]
twist = { KIND = { file = "plan.csv", columns = ["t", "x"] } }
"""
_PLAN = b"""t,x,other
0.0,0.1,7
0.03,0.2,8
0.06,-0.1,9
"0.1",1e-2,1
"""


@cache
def _robot_files() -> tuple[bytes, ...]:
    return tuple(path.read_bytes() for path in sorted(bundled_folder().glob("**/*.urdf")))


@cache
def _cat() -> pinred.System:
    return pinred.load("falling_cat")


@cache
def _recordings() -> dict[str, bytes]:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        traj = pinred.simulate(_cat(), duration=0.1, times=[0.0, 0.05, 0.1])
        contents = {}
        for suffix in (".npz", ".csv"):
            path = Path(folder, f"traj{suffix}")
            traj.save(path)
            contents[suffix] = path.read_bytes()
    return contents


def prepare() -> None:
    """Create and compile everything that all inputs need, before child processes are forked."""
    _robot_files(), _recordings(), _cat()
    with suppress(pinred.PinredError):
        pinred.simulate(_cat(), duration=0.01, passive=True)


def mutated(rng: Rng, text: bytes) -> bytes:
    """Return a text with random changes of numbers, bytes, words and lines."""
    if rng.random() < 0.02:  # garbage
        return rng.bytes(int(rng.integers(0, 400)))
    for _ in range(int(rng.integers(1, 5))):
        n = max(1, len(text))
        a, b = sorted(int(k) for k in rng.integers(0, n, 2))
        b = min(b, a + int(rng.integers(1, 80)))
        change = int(rng.integers(0, 9))
        if change <= 2:
            numbers = list(_NUMBER.finditer(text))
            if numbers:
                match = numbers[int(rng.integers(len(numbers)))]
                word = _WORDS[int(rng.integers(len(_WORDS)))]
                if change == 2:
                    word = b"%g" % (float(rng.normal()) * 10.0 ** float(rng.integers(-30, 30)))
                text = text[: match.start()] + word + text[match.end() :]
        elif change == 3:
            text = text[:a] + text[b:]
        elif change == 4:
            text = text[:b] + text[a:b] * int(rng.integers(1, 4)) + text[b:]
        elif change == 5:
            text = text[:a] + _BYTES[int(rng.integers(len(_BYTES)))] + text[a:]
        elif change == 6:
            lines = text.split(b"\n")
            i, j = rng.integers(0, len(lines), 2)
            lines[i], lines[j] = lines[j], lines[i]
            text = b"\n".join(lines)
        elif change == 7:
            words = re.findall(rb"\w+", text)
            if words:
                word, replacement = (words[int(k)] for k in rng.integers(0, len(words), 2))
                text = text.replace(word, replacement, 1)
        elif rng.random() < 0.3:
            text = text[:a]
    return text


def _sound(system: pinred.System) -> str:
    """Return a description of a non-finite property at the zero shape, or ""."""
    at = pinred.Reduction(system).at(np.zeros(system.m))
    for name in ("locked_inertia", "local_connection", "reduced_metric"):
        if not np.isfinite(getattr(at, name)).all():
            return f"{name} is not finite"
    return ""


def urdf(rng: Rng, folder: Path) -> str:
    """Load a mutated bundled URDF."""
    texts = _robot_files()
    path = folder / "robot.urdf"
    path.write_bytes(mutated(rng, texts[int(rng.integers(len(texts)))]))
    return _sound(pinred.load(path))


def mjcf(rng: Rng, folder: Path) -> str:
    """Load a mutated MJCF file."""
    path = folder / "robot.xml"
    path.write_bytes(mutated(rng, _MJCF))
    return _sound(pinred.load(path))


def scene(rng: Rng, folder: Path) -> str:
    """Read a mutated scene file, without running it."""
    path = folder / "scene.toml"
    path.write_bytes(mutated(rng, _SCENE))
    start = read_scene_file(path).scene.start
    return "" if np.isfinite(start.mu).all() else "the momentum is not finite"


def signal(rng: Rng, folder: Path) -> str:
    """Read a prescribed joint from a mutated CSV file; its values must be finite."""
    (folder / "plan.csv").write_bytes(mutated(rng, _PLAN))
    path = folder / "scene.toml"
    path.write_bytes(_PLANNED.replace(b"KIND", (b"spline", b"linear")[int(rng.integers(2))]))
    scene = read_scene_file(path).scene
    assert scene.force_model is not None
    for t in (0.0, 0.05, 0.1):
        prescribed = scene.force_model.prescribed(t, scene.force_model.numbers)
        if not np.isfinite(np.concatenate([prescribed.x, prescribed.xdot, prescribed.xddot])).all():
            return "the plan is not finite"
    return ""


def recording(rng: Rng, folder: Path) -> str:
    """Read a recording with mutated bytes or with one replaced array."""
    path = folder / "traj.npz"
    if rng.random() < 0.5:
        path.write_bytes(mutated(rng, _recordings()[".npz"]))
    else:
        import io

        arrays = dict(np.load(io.BytesIO(_recordings()[".npz"])))
        name = list(arrays)[int(rng.integers(len(arrays)))]
        odd = _odd(rng)
        with suppress(ValueError, OverflowError, TypeError):
            arrays[name] = np.array(odd)
        if arrays[name].dtype.hasobject:
            arrays[name] = np.array(str(odd)[:50])
        np.savez(path, **arrays)
    recorded = read_recording(path)
    return (
        "" if np.isfinite(recorded.t).all() and recorded.system.m >= 0 else "times are not finite"
    )


def arguments(rng: Rng, folder: Path) -> str:
    """Run a short command line with random words."""
    options = ["--duration", "--seed", "--x0", "--xdot0", "--xi0", "--momentum", "--pose0", "--q0",
               "--v0", "--rtol", "--atol", "--method", "--step", "--order", "--engine",
               "--outputs", "--springs", "--prescribed", "--lock", "--gravity", "--group",
               "--friction", "--keyframe", "--root", "--at", "--samples", "--out", "--passive",
               "--strict", "--validate", "--explain"]  # fmt: skip
    words = ["", "-", "--", "1", "-1", "0", "1e400", "nan", "x", "bend", "bend=1", "bend=", "=1",
             "1,2,3", "1,,2", "bend=sin(t)", "bend=t**1e9", "DOP853(", "Gauss(0.01, 8)", "SE3",
             "SO2", "\0", "é", "9" * 400, "0,0,0", "Radau(rtol=x)", "a" * 5000, "/", ".",
             str(folder), "bend=__import__('os')", "traj.npz", "RKMK4(1e-300)"]  # fmt: skip
    verbs = ["inspect", "run", "robots", "cache", "plot", "play", "inspec", "simulate"]
    command_line = [str(rng.choice(verbs))]
    if rng.random() < 0.9:
        command_line.append(
            str(rng.choice(["falling_cat", "nobody", "rigid_body", str(folder), ""]))
        )
    for _ in range(int(rng.integers(0, 4))):
        command_line.append(str(rng.choice(options)))
        if rng.random() < 0.8:
            command_line.append(words[int(rng.integers(len(words)))])
    if command_line[0] == "simulate":  # keep it short, and write into the test folder only
        command_line += ["--duration", "0.01", "--out", str(folder / "traj.npz")]
    try:
        code = command(command_line)
    except SystemExit as stop:
        code = int(stop.code or 0)
    return "" if code in (0, 1, 2, 3) else f"exit code {code}"


def options(rng: Rng, _: Path) -> str:
    """Build a scene with options of random types and sizes; simulate it if it is short."""
    names = ["x0", "xdot0", "xi0", "momentum", "seed", "keyframe", "pose0", "q0", "v0", "duration",
             "times", "rtol", "atol", "springs", "forces", "prescribed", "passive", "friction",
             "outputs", "method"]  # fmt: skip
    values: dict[str, Any] = {"duration": 0.01}
    if rng.random() < 0.3:
        key = str(rng.choice(["lock", "gravity", "group", "root", "strict", "meshes"]))
        return _sound(pinred.load("falling_cat", **{key: _odd(rng)}))
    for name in rng.choice(names, int(rng.integers(1, 3)), replace=False):
        values[str(name)] = _odd(rng)
    if rng.random() < 0.2:
        values["engine"] = _odd(rng)
    if rng.random() < 0.1:
        batch = pinred.simulate_many(_cat(), seeds=_odd(rng), duration=0.01)
        return "" if np.isfinite(batch.t).all() else "times are not finite"
    if "duration" in values and not _short(values["duration"]):
        pinred.Scene(system=_cat(), **{k: v for k, v in values.items() if k != "engine"})
        return ""
    traj = pinred.simulate(_cat(), **values)
    return "" if np.isfinite(traj.x).all() else "the shape is not finite"


def _short(duration: Any) -> bool:
    with suppress(TypeError, ValueError, OverflowError):
        return bool(float(duration) <= 0.1)
    return True


def _odd(rng: Rng) -> Any:
    """Return a value of a random type."""
    values: list[Callable[[], Any]] = [
        lambda: None, lambda: True, lambda: 0, lambda: -1, lambda: 10**400, lambda: -(10**30),
        lambda: math.nan, lambda: math.inf, lambda: 1e300, lambda: 1e-300, lambda: 0.01,
        lambda: "", lambda: "bend", lambda: "SE3", lambda: "all", lambda: "\0", lambda: b"bytes",
        lambda: "x" * 3000, list, lambda: [1.0], lambda: [1.0, 2.0, 3.0], lambda: [None],
        lambda: ["bend"], lambda: [[1.0, 2.0], [3.0]], dict, lambda: {"bend": 1.0},
        lambda: {"bend": (1.0, 2.0)}, lambda: {"nobody": 1.0}, lambda: {1: 2},
        lambda: {"bend": None}, lambda: {"bend": 10**400}, lambda: {"bend": "sin(t)"},
        lambda: np.zeros(3), lambda: np.zeros((2, 3)), lambda: np.zeros(0), lambda: np.array(1.0),
        lambda: np.array(["bend"]), lambda: np.array([1, None], dtype=object), lambda: np.eye(4),
        lambda: np.full(3, np.nan), lambda: np.zeros(3, dtype=complex), lambda: 1 + 2j,
        lambda: object(), lambda: object, lambda: len, lambda: range(3), lambda: {1, 2},
        lambda: iter([1.0]), lambda: Path("x"), lambda: slice(1), lambda: np.datetime64("2020"),
        lambda: np.zeros(3, dtype="V8"), lambda: (0, 0.01), lambda: [10**400] * 3,
        lambda: list(rng.normal(size=int(rng.integers(0, 8)))), lambda: float(rng.normal()),
        lambda: int(rng.integers(-5, 50)), lambda: "DOP853", lambda: "RKMK4(0.001)",
        lambda: np.ma.masked, lambda: memoryview(b"abc"), lambda: pinred, lambda: ...,
    ]  # fmt: skip
    return values[int(rng.integers(len(values)))]()


KINDS: dict[str, Callable[[Rng, Path], str]] = {
    "urdf": urdf,
    "mjcf": mjcf,
    "scene": scene,
    "recording": recording,
    "arguments": arguments,
    "options": options,
    "signal": signal,
}
NUMBER = {kind: number for number, kind in enumerate(KINDS)}
