"""Options of commands have the names of Python's keywords and of the keys of files."""

from __future__ import annotations

import argparse
import inspect
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pinred
from pinred.analysis.connections.connection import Connection
from pinred.analysis.equilibria.relative_equilibrium import RelativeEquilibrium
from pinred.cli import command_line
from pinred.cli.command_line import COMMANDS, main
from pinred.cli.command_options import FORMER
from pinred.integrators.methods import Gauss
from pinred.laboratory.corpus.run_corpus import corpus
from pinred.planning.gait_file import GAIT_FILE, OPTIMISE, REORIENT
from pinred.scene.scene_options import LOAD, SWEEP_OPTIONS
from pinred.scene.toml.reader import FILE_OPTIONS

_CONNECTION = (pinred.load, Connection.mechanical, Connection.in_chart)
# The Python functions of each command.
FUNCTIONS: dict[str, tuple[Callable[..., Any], ...]] = {
    "inspect": (pinred.load, pinred.inspect),
    "equilibria": (
        pinred.load, pinred.relative_equilibria, pinred.branches, RelativeEquilibrium.scene,
        pinred.plot,
    ),
    "compare": (pinred.load, pinred.Scene, pinred.simulate, pinred.compare, Gauss),
    "simulate": (pinred.load, pinred.Scene, pinred.simulate, Gauss),
    "run": (pinred.simulate,),
    "sweep": (pinred.sweep, pinred.simulate),
    "plot": (pinred.load, pinred.Scene, pinred.plot, pinred.read_recording),
    "play": (pinred.play, pinred.save_film, pinred.read_recording),
    "feel": (pinred.load, pinred.feel),
    "phase": (*_CONNECTION, pinred.phase),
    "gait": (*_CONNECTION, pinred.optimise_gait),
    "reorient": (pinred.load, pinred.reorient),
    "field": (*_CONNECTION, pinred.plot),
    "corpus": (corpus,),
}  # fmt: skip
# What Python states in another way: {option: that way}.
ONLY_IN_COMMANDS = {
    "out": "save, savefig, save_html, save_film, save_rrd",
    "samples": "times=np.linspace(…)",
    "until": "events=Event(…, terminal=True)",
    "compare": "compare(traj), plan.report",
    "validate": "load_scene",
    "schema": "scene_schema()",
    "check-steps": "check=True; `--check` is a former name of `--validate`",
    "at": "the second argument of inspect",
    "play": "play(traj)",
    "no-open": "show=False",
    "no-meshes": "meshes=False",
    "any-winding": "winding=None",
    "distance": "BestGait.distance()",
    "cycles": "Phase.cycles(…)",
    "circle": "Gait.fourier(…)",
}
# The tables of keys of files whose keys are options of commands.
FILES = {
    "scene": (FILE_OPTIONS, LOAD.keys),
    "gait": (OPTIMISE.keys, LOAD.keys, GAIT_FILE.keys),
    "reorient": (REORIENT.keys, LOAD.keys, GAIT_FILE.keys),
    "sweep": (SWEEP_OPTIONS, FILE_OPTIONS),
}


def _actions(command: str) -> list[argparse.Action]:
    """Return the options of a command."""
    parser = command_line._parser([command])
    (commands,) = (a for a in parser._actions if isinstance(a, argparse._SubParsersAction))
    sub = commands.choices[command]
    return [action for action in sub._actions if action.option_strings and action.dest != "help"]


def _shown(command: str) -> Iterator[tuple[str, argparse.Action]]:
    """Yield the name, without dashes, of each option that `--help` shows."""
    for action in _actions(command):
        if action.help != argparse.SUPPRESS:
            yield action.option_strings[0].removeprefix("--"), action


def _keywords(command: str) -> set[str]:
    return {
        name for function in FUNCTIONS[command] for name in inspect.signature(function).parameters
    }


@pytest.mark.parametrize("command", FUNCTIONS)
def test_option_of_command_is_keyword_of_its_python_functions(command: str) -> None:
    """An option without a keyword of its name is listed, with Python's way to state it."""
    keywords = _keywords(command)
    for name, _ in _shown(command):
        assert name.replace("-", "_") in keywords or name in ONLY_IN_COMMANDS, name


def test_option_only_in_commands_has_no_keyword_in_all_commands() -> None:
    """The list of exceptions has no entry that is no exception."""
    shown = {command: {name for name, _ in _shown(command)} for command in FUNCTIONS}
    assert ONLY_IN_COMMANDS.keys() <= set().union(*shown.values())
    for name in ONLY_IN_COMMANDS:
        commands = [command for command, names in shown.items() if name in names]
        assert any(name.replace("-", "_") not in _keywords(command) for command in commands), name


def test_key_of_file_with_option_states_the_name_of_the_option() -> None:
    """Keys, options and keywords have one name, except the option that another meaning has."""
    tables = [table for tables in FILES.values() for table in tables]
    for key, option in {k: v for table in tables for k, v in table.items()}.items():
        flag = option.command.partition(" ")[0]
        dashed = f"--{key.replace('_', '-')}"
        assert flag in ("", dashed) or (key, flag) == ("check", "--check-steps")


@pytest.mark.parametrize("command", ["simulate", "compare", "gait", "reorient", "sweep", "plot"])
def test_option_that_files_have_is_described_as_in_files(command: str) -> None:
    """`--help` shows the one description of a key, so option and key cannot differ."""
    tables = FILES.get(command, FILES["scene"])
    keys = {name: key for table in reversed(tables) for name, key in table.items()}
    common = [(name, action) for name, action in _shown(command) if name in keys]
    assert len(common) > 3
    for name, action in common:
        if keys[name].command:
            assert str(action.help).startswith(keys[name].text.replace("%", "%%")), name


@pytest.mark.parametrize("command", COMMANDS)
def test_former_name_of_option_is_accepted_and_hidden(command: str) -> None:
    """Every option that was renamed has its former name in all commands, which help omits."""
    actions = {action.option_strings[0]: action for action in _actions(command)}
    for flag, former in FORMER.items():
        if flag in actions:
            new, old = actions[flag], actions[former]
            assert (new.dest, new.type, type(new)) == (old.dest, old.type, type(old))
            assert old.help == argparse.SUPPRESS


def test_time_is_duration_of_all_commands_and_python(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """`--time`, `--duration` and duration= give one motion; repeated options of both names add."""
    robot, paths = ["simulate", "coupled_planar", "--xdot0", "1", "--samples", "3"], []
    for name in ("--time", "--duration", "--dur"):
        paths.append(tmp_path / f"{name}.npz")
        assert main([*robot, name, "0.25", "--out", str(paths[-1])]) == 0
    traj = pinred.simulate(
        pinred.load("coupled_planar"), xdot0=[1.0], duration=0.25, times=[0.0, 0.125, 0.25]
    )
    for path in paths:
        with np.load(path) as file:
            np.testing.assert_array_equal(file["t"], traj.t)
            np.testing.assert_array_equal(file["pose"], traj.pose)
    words = ["inspect", "falling_cat", "--parameter", "front.mass=1", "--parameters"]
    assert main([*words, "front.mass=2"]) == 2
    assert "--parameters has 'front.mass' twice" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("simulate cartpole --duratoin 3", "'--duratoin'; did you mean '--duration'? See"),
        ("simulate cartpole --tme=3", "'--tme'; did you mean '--duration'? See"),
        ("simulate cartpole -x -1", "'-x'; did you mean '--x0'? See"),
        ("simulate cartpole --qqqqq", "'--qqqqq'; see"),
        ("plot cartpole --knd shape", "'--knd'; did you mean '--kind'? See"),
        ("bench many --membres 3", "'--membres'; did you mean '--members'? See"),
    ],
)
def test_unknown_option_names_nearest_option_and_help(
    words: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The message comes before the complaint about options that are missing."""
    with pytest.raises(SystemExit) as end:
        main(words.split())
    command = re.match(r"[a-z ]+many|[a-z]+", words)
    assert end.value.code == 2
    assert command is not None
    expected = f"pinred: error: unknown option {message} `pinred {command[0]} --help`\n"
    assert capsys.readouterr().err == expected


def test_unexpected_argument_names_help_of_command(capsys: pytest.CaptureFixture[str]) -> None:
    """A word too many is reported by the command, not by `pinred`; values may look like options."""
    with pytest.raises(SystemExit):
        main(["simulate", "cartpole", "two", "--out=--x.npz"])
    assert "unexpected argument 'two'; see `pinred simulate --help`" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(["inspect", "--", "cartpole", "--tme"])
    assert "unexpected argument '--tme'" in capsys.readouterr().err


def test_default_kind_of_plot_command_is_that_of_python(tmp_path: Path) -> None:
    """`pinred plot` draws the figure of pinred.plot without a kind."""
    default = inspect.signature(pinred.plot).parameters["kind"].default
    (kind,) = (action for name, action in _shown("plot") if name == "kind")
    assert kind.default == default == "shape"
    path = tmp_path / "figure.svg"
    texts = []
    for more in ([], ["--kind", "shape"]):
        assert main(["plot", "cartpole", "--duration", "0.1", *more, "--out", str(path)]) == 0
        texts.append(re.sub(r'(id=|#)"?\w+', "", path.read_text()))
    assert texts[0] == texts[1]
