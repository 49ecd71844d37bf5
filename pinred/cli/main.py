"""The command line: the same things as the Python API, by the same names.

Each command is a file of this folder with `add_arguments` and `run`.  It is imported only
when the command is asked for, so that help is instant.
"""

from __future__ import annotations

import argparse
import os
import sys
import warnings
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NoReturn

from ..common.errors import IntegrationError, LeftOutWarning, ModelWarning, PinredError
from ..common.plain_names import plain
from ..common.version import __version__
from .interrupt import CODE, say
from .options import VECTORS
from .terminal import showing_all

_LONGEST = 4000  # characters of a message
COMMANDS = {  # name of the command and of its file: what it does
    "inspect": "show group, joints, I, A, M and what will be skipped",
    "equilibria": "find steady motions, judge their stability, follow them over the momentum",
    "compare": "simulate the reduced equations and judge them by full ABA",
    "simulate": "simulate the reduced equations and write the motion",
    "run": "simulate what a scene file says",
    "plot": "draw a motion, or what bench accuracy measured",
    "play": "play a motion in a browser, or write it as a film",
    "phase": "what a gait does to the body, cycle after cycle",
    "gait": "find the loop that does most to the body for what it costs",
    "reorient": "turn the base by a motion of the joints",
    "field": "draw the connection of a robot over two joints",
    "robots": "list the robots that can be loaded by name",
    "cache": "show the compiled kernels kept on disk",
    "stress": "check the numbers where they are hard",
    "corpus": "try all robot descriptions in some folders, as a table",
    "bench": "measure speed and accuracy",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command.  Returns 0, or 1 if a comparison does not pass, or 2 on bad input."""
    with showing_all():
        return _run(arguments)


def _run(arguments: Sequence[str] | None) -> int:
    words = _joined(sys.argv[1:] if arguments is None else arguments)
    options = _parser(words).parse_args(words)
    try:
        with warnings.catch_warnings():
            # What overflows or is not finite is refused or stopped by name; numpy need not say
            # so too.
            warnings.simplefilter("ignore", RuntimeWarning)
            for kind in (ModelWarning, LeftOutWarning):
                warnings.simplefilter("always", kind)
            warnings.showwarning = _warned  # type: ignore[assignment]
            code: int = options.run(options)
        print(end="", flush=True)
    except PinredError as error:
        return _failed(str(error), 1 if isinstance(error, IntegrationError) else 2)
    except MemoryError:
        return _failed("not enough memory for this many numbers", 2)
    except KeyboardInterrupt:
        say()
        return CODE
    except BrokenPipeError:  # the reader of our output has gone, as in `pinred robots | head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _failed(f"cannot write the output: {error.strerror}", 2)
    return code


def _warned(message: Warning | str, *_: Any) -> None:
    """Print a warning as one line on standard error."""
    print(f"pinred: warning: {plain(str(message), _LONGEST)}", file=sys.stderr)


def _failed(message: str, code: int) -> int:
    """Print a message as one line on standard error and return the exit code."""
    print(f"pinred: error: {plain(message, _LONGEST)}", file=sys.stderr)
    return code


class _Parser(argparse.ArgumentParser):
    """An argument parser that says what is wrong in one line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"pinred: error: {plain(message, _LONGEST)}; see `{self.prog} --help`\n")


def _joined(arguments: Sequence[str]) -> list[str]:
    """Return the arguments with vectors tied to their option, for those that begin with a minus."""
    out: list[str] = []
    for argument in arguments:
        if out and out[-1] in VECTORS:
            out[-1] += f"={argument}"
        else:
            out.append(argument)
    return out


def _parser(arguments: Sequence[str]) -> _Parser:
    """Return the parser for arguments, which knows the options of the command in them."""
    parser = _Parser(
        prog="pinred",
        description="Reduce multibody systems with symmetry and compare with the full simulation.",
    )
    parser.add_argument("--version", action="version", version=f"pinred {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    chosen = arguments[0] if arguments else ""
    for name, text in COMMANDS.items():
        sub = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        if name == chosen:
            command = import_module(f"..{name}", __name__)
            sub.set_defaults(run=command.run)
            command.add_arguments(sub)
    return parser


if __name__ == "__main__":
    sys.exit(main())
