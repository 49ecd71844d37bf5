"""Options are shown by name: to help(), to inspect, and to type checkers, which refuse others."""

from __future__ import annotations

import inspect
import os
import pydoc
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, get_overloads

import pytest

import pinred
from pinred.scene.scene_options import SceneOptions
from pinred.views.playback.colours_and_view_options import FILM_FPS, View, ViewOptions
from pinred.views.plots import KINDS

ROOT = Path(__file__).parent.parent
Shown = dict[str, tuple[str, Any]]  # of each option: its type and its default


def options_of(kind: type) -> Shown:
    """The options that a dataclass holds."""
    return {
        entry.name: (
            str(entry.type),
            entry.default if entry.default_factory is MISSING else entry.default_factory(),
        )
        for entry in fields(kind)
        if entry.default is not MISSING or entry.default_factory is not MISSING
    }


def keywords_of(function: Callable[..., Any]) -> Shown:
    """The keyword-only parameters of a function."""
    return {
        name: (parameter.annotation, parameter.default)
        for name, parameter in inspect.signature(function).parameters.items()
        if parameter.kind is inspect.Parameter.KEYWORD_ONLY
    }


@pytest.mark.parametrize(("typed", "kind"), [(SceneOptions, pinred.Scene), (ViewOptions, View)])
def test_typed_options_are_the_fields(typed: type, kind: type) -> None:
    """Names and types that type checkers see are those of the dataclass, in its order."""
    seen = {name: hint.__forward_arg__ for name, hint in typed.__annotations__.items()}
    assert list(seen) == list(options_of(kind))
    assert seen == {name: hint for name, (hint, _) in options_of(kind).items()}
    assert not typed.__required_keys__  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("function", "kind", "own"),
    [
        (pinred.simulate, pinred.Scene, {"engine", "progress", "explain", "check", "checkpoint"}),
        (
            pinred.simulate_many,
            pinred.Scene,
            {"threads", "device", "seeds", "progress", "members", "explain", "invalid"},
        ),
        (pinred.play, View, {"viewer", "port", "show", "wait"}),
        (pinred.save_html, View, {"feel"}),
        (pinred.save_film, View, {"size", "progress"}),
        (pinred.save_rrd, View, set()),
    ],
)
def test_shown_options_are_the_fields(
    function: Callable[..., Any], kind: type, own: set[str]
) -> None:
    """Every option is in the signature and in help(), with the type and default of its field."""
    shown, wanted = keywords_of(function), options_of(kind)
    if function is pinred.save_film:
        wanted["fps"] = ("float", FILM_FPS)
    assert {name: shown[name] for name in shown if name not in own} == wanted
    assert own <= shown.keys()
    text = re.sub(".\b", "", pydoc.render_doc(function))
    for name, (hint, default) in wanted.items():
        assert f"{name}: {hint!r} = {default!r}" in text


def test_plots_show_their_options() -> None:
    """For each kind, `plot` has an overload with what its function takes, and shows all."""
    every: Shown = {}
    seen = []
    for overload in get_overloads(pinred.plot):
        kinds = inspect.signature(overload, eval_str=False).parameters["kind"].annotation
        named = re.findall(r'[\'"](\w+)[\'"]', kinds)
        assert keywords_of(overload) == {} or named
        for kind in named:
            assert keywords_of(overload) == keywords_of(getattr(pinred.plots, kind))
            first = next(iter(inspect.signature(getattr(pinred.plots, kind)).parameters.values()))
            source = inspect.signature(overload).parameters["source"]
            assert source.annotation == first.annotation
            seen.append(kind)
        every |= keywords_of(overload)
    assert sorted(seen) == sorted(KINDS)
    assert keywords_of(pinred.plot) == every
    assert {"joints", "limits", "when", "component", "against"} <= every.keys()
    for kind in KINDS:  # what one kind has for default, every kind has that takes the option
        for name, shown in keywords_of(getattr(pinred.plots, kind)).items():
            assert every[name] == shown


def test_methods_of_a_trajectory_show_their_options() -> None:
    """Nothing that can be done with a trajectory hides what it takes."""
    for name, method in inspect.getmembers(pinred.Trajectory, inspect.isfunction):
        kinds = {p.kind for p in inspect.signature(method).parameters.values()}
        assert not kinds & {inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL}, name


SNIPPET = """
import numpy as np
import pinred
from pinred.signals import Fourier

cat = pinred.load("falling_cat")
traj = pinred.simulate(
    cat, x0={"bend": 0.5}, xdot0=[0.0, 0.0, 1.0], method="DOP853", rtol=1e-8,
    prescribed={"sway": "0.4*sin(t)", "twist": 0.1, "bend": Fourier(0.0, [], [1.0], 2.0)},
)
pinred.simulate(cat, q0=np.zeros(10), v0=np.zeros(9), method=pinred.RKMK4(0.01), engine="pinocchio")
pinred.simulate_many(cat, x0={"bend": np.zeros(3)}, momentum=0, times=[1.0], threads=2)
pinred.plot(traj, "phase", joints=("bend", 0), when=1.0)
pinred.plot(traj)
pinred.plots.curvature(cat, component="w3")
pinred.play(traj, ghost=True, pair=("bend", "sway"))
for kind in ("shape", "base"):
    pinred.plot(traj, kind)
pinred.simulate(cat, xO={"bend": 0.5})  # call-arg
pinred.simulate(cat, duration="2")  # arg-type
pinred.simulate(cat, method=8)  # arg-type
pinred.simulate(cat, x0={0: 0.5})  # dict-item
pinred.simulate(cat, outputs="base")  # arg-type
pinred.simulate(cat, engine="steam")  # arg-type
pinred.simulate(cat, prescribed={"sway": None})  # dict-item
pinred.simulate_many(cat, seeds=[1], duraton=2.0)  # call-arg
pinred.simulate_many(cat, seeds=[1], forces=3)  # arg-type
pinred.Scene(system=cat, momentun=0)  # call-arg
pinred.plot(traj, "shape", joint=("bend",))  # call-overload
pinred.plot(traj, "base", joints=("bend",))  # call-overload
pinred.plot(traj, "sphere", when="now")  # call-overload
pinred.plots.shape(traj, joint=("bend",))  # call-arg
pinred.play(traj, gost=True)  # call-arg
pinred.save_html(traj, "cat.html", speed="fast")  # arg-type
pinred.save_film(traj, "cat.mp4", frames=3)  # call-arg
traj.save(3)  # arg-type
traj(t="now", at=1)  # call-arg
"""


FOLDERS = ("pinred", "tests", "examples")
# Garbage collection frees nothing here, and takes a fifth of a run.
MYPY = """
import gc
gc.disable()
gc.enable = lambda: None
from mypy.__main__ import console_entry
console_entry()
"""


@pytest.mark.by_hand
def test_mypy_reports_only_the_misspelt_options_and_wrong_types(tmp_path: Path) -> None:
    """Mypy finds no fault in the checkout, and exactly the marked lines of the snippet.

    One run checks both, because it takes a minute; `.ci/run` and the nightly workflow run it.  A
    cache is used where there is one; to write one takes a tenth of the run.
    """
    path = tmp_path / "snippet.py"
    path.write_text(SNIPPET, encoding="utf-8")
    cache = ROOT / ".mypy_cache"
    options = ["--no-pretty", f"--cache-dir={cache if cache.exists() else os.devnull}"]
    process = subprocess.run(
        [sys.executable, "-c", MYPY, *options, *FOLDERS, str(path)],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    pattern = r"^(.*):(\d+): error: .*\[([\w-]+)\]$"
    errors = re.findall(pattern, process.stdout, re.MULTILINE)
    expected = [
        (str(number), line.split("  # ")[1])
        for number, line in enumerate(SNIPPET.split("\n"), 1)
        if "  # " in line
    ]
    assert len(expected) >= 18
    assert {Path(file).name for file, *_ in errors} == {"snippet.py"}, process.stdout
    reported = sorted({(line, code) for _, line, code in errors})
    assert reported == sorted(expected), process.stdout + process.stderr
