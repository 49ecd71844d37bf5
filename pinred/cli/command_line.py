"""The command line: the functions of the Python API under the same names.

The functions `add_<command>_arguments` and `run_<command>` are in `<group>_commands.py`.
The module is imported when its command is used, so that `pinred --help` stays fast.
"""

from __future__ import annotations

import argparse
import codecs
import os
import re
import sys
import unicodedata
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib import import_module
from typing import Any, NoReturn

from ..common.errors import (
    AccuracyWarning,
    IntegrationError,
    LeftOutWarning,
    ModelWarning,
    PinredError,
    RejectedWarning,
    SceneWarning,
    __version__,
    shorten_message,
)
from ..common.names import most_similar, plain, quoted
from ..common.waiting import INTERRUPTED, report_interrupt
from .command_options import FORMER

_SHOWN = (AccuracyWarning, ModelWarning, LeftOutWarning, RejectedWarning, SceneWarning)
_LONGEST = 2000  # largest number of characters of a message
_OPTION, _NEGATIVE = re.compile(r"--[\w-]+"), re.compile(r"-(\d|\.\d|inf|nan)")
_SHORT = re.compile(r"-[A-Za-z]\w*")
COMMANDS = {  # {command: description}
    "inspect": "show group, joints, I, A, M, and the parts of the simulation that can be skipped",
    "equilibria": "find relative equilibria, their stability, and branches over the momentum",
    "compare": "simulate the reduced equations and compare with the full simulation by ABA",
    "simulate": "simulate the reduced equations and write the motion to a file",
    "run": "simulate the scene in a TOML file",
    "sweep": "simulate many points of the scene in a TOML file, and store the results",
    "capture": "join two robots at frames that meet, with the impulse and the motion after it",
    "release": "divide a robot at a joint",
    "land": "stop a foot of a robot in flight, with the impulse and the motion about it",
    "plot": "draw a motion, or the results of `pinred bench accuracy`",
    "play": "play a motion in a browser, or write it as a film",
    "feel": "move the joints by hand in a browser, while the base turns by the connection",
    "phase": "compute the geometric and dynamic phase of a gait, cycle after cycle",
    "gait": "find the gait with the largest displacement for its cost",
    "reorient": "plan a joint motion that rotates the base",
    "field": "draw the connection of a robot over two joints",
    "robots": "list the robots that can be loaded by name",
    "cache": "show the compiled kernels on disk, or compile ahead: cache warm ROBOT",
    "doctor": "check the installation, and say what is missing and how to get it",
    "published": "compare published and closed-form results with those of pinred",
    "stress": "check the accuracy in numerically hard cases",
    "corpus": "try all robot descriptions in some folders",
    "bench": "measure speed and accuracy",
}
_GROUPS = {  # {module without "_commands": its commands}
    "analysis": ("inspect", "robots", "equilibria", "phase", "gait", "reorient"),
    "motion": ("compare", "simulate", "run", "sweep", "capture", "release", "land"),
    "view": ("plot", "play", "feel", "field"),
    "installation": ("cache", "doctor"),
    "laboratory": ("published", "stress", "corpus", "bench"),
}

_ERRORS = "pinred-ascii"
_ASCII = {
    "×": "x", "·": "*", "²": "^2", "³": "^3", "−": "-", "–": "-", "—": "-", "→": "->", "…": "...",
    "±": "+-", "≤": "<=", "≥": ">=", "≈": "~", "√": "sqrt", "∞": "inf", "°": "deg", "█": "#",
    "ẋ": "xdot", "ẍ": "xddot", "ξ": "xi", "μ": "mu", "µ": "mu", "θ": "theta", "ω": "omega",
    "Ω": "Omega", "π": "pi", "τ": "tau", "α": "alpha", "β": "beta", "∂": "d", "ℝ": "R",
    "Δ": "Delta",
}  # fmt: skip


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command of the command line.

    Args:
        arguments: Words after `pinred`; None for the arguments of the process.
    Returns:
        0; 1 if a comparison or an integration fails; 2 on invalid input; 3 if a comparison
        cannot tell; 130 after Ctrl-C.
    """
    with showing_all():
        return _run(arguments)


def _run(arguments: Sequence[str] | None) -> int:
    words = _join_negative(sys.argv[1:] if arguments is None else arguments)
    options = _parser(words).parse_args(words)
    try:
        with warnings.catch_warnings():
            # Overflow and NaN are reported by pinred, so numpy's warnings would repeat them.
            warnings.simplefilter("ignore", RuntimeWarning)
            for category in _SHOWN:
                warnings.simplefilter("always", category)
            warnings.showwarning = _print_warning  # type: ignore[assignment]
            code: int = options.run(options)
        print(end="", flush=True)
    except PinredError as error:
        return _print_error(str(error), 1 if isinstance(error, IntegrationError) else 2)
    except MemoryError:
        return _print_error("not enough memory for this many numbers", 2)
    except KeyboardInterrupt:
        report_interrupt()
        return INTERRUPTED
    except BrokenPipeError:  # The reading process has ended, as in `pinred robots | head`.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return _print_error(f"cannot write the output: {error.strerror}", 2)
    return code


def _print_warning(message: Warning | str, *_: Any) -> None:
    """Print a warning as one line on standard error."""
    print(f"pinred: warning: {plain(shorten_message(str(message)), _LONGEST)}", file=sys.stderr)


def _print_error(message: str, code: int) -> int:
    """Print a message as one line on standard error and return the exit code."""
    print(f"pinred: error: {plain(shorten_message(message), _LONGEST)}", file=sys.stderr)
    return code


class _Parser(argparse.ArgumentParser):
    """An argument parser that reports an error in one line, and names its own command."""

    def parse_known_args(self, args: Any = None, namespace: Any = None) -> Any:
        """Parse words; the parser of a subcommand rejects unknown ones itself."""
        if self._subparsers is None:  # Other parsers see the options of their subcommands, too.
            self._refuse_unknown(args)
        options, unknown = super().parse_known_args(args, namespace)
        if unknown:
            self.error(f"unexpected argument {quoted(unknown[0])}")
        return options, unknown

    def _refuse_unknown(self, words: Sequence[str]) -> None:
        """Exit with the nearest option if an option is unknown."""
        flags = list(self._option_string_actions)
        for word in words:
            flag = word.partition("=")[0]
            if word == "--":
                return
            is_option = _OPTION.fullmatch(flag) or _SHORT.fullmatch(flag)
            if not is_option or any(name.startswith(flag) for name in flags):
                continue
            now = {former: name for name, former in FORMER.items()}
            near = most_similar(flag, flags)
            question = f"did you mean '{now.get(near, near)}'? See" if near else "see"
            self.exit(
                2,
                f"pinred: error: unknown option {quoted(flag)}; {question} `{self.prog} --help`\n",
            )

    def error(self, message: str) -> NoReturn:
        text = plain(shorten_message(message), _LONGEST)
        self.exit(2, f"pinred: error: {text}; see `{self.prog} --help`\n")


def _join_negative(arguments: Sequence[str]) -> list[str]:
    """Join "--option" and a value such as "-1,2" with "=", because argparse requires it."""
    words: list[str] = []
    for argument in arguments:
        if words and _OPTION.fullmatch(words[-1]) and _NEGATIVE.match(argument):
            words[-1] += f"={argument}"
        else:
            words.append(argument)
    return words


def _parser(arguments: Sequence[str]) -> _Parser:
    """Return the parser; add options only for the command that the arguments name."""
    parser = _Parser(
        prog="pinred",
        description="Reduce multibody systems with symmetry and compare with the full simulation.",
    )
    parser.add_argument("--version", action="version", version=f"pinred {__version__}")
    commands = parser.add_subparsers(title="commands", metavar="COMMAND", required=True)
    command = arguments[0] if arguments else ""
    for name, text in COMMANDS.items():
        sub = commands.add_parser(name, help=text, description=text[0].upper() + text[1:] + ".")
        if name == command:
            (group,) = (group for group, names in _GROUPS.items() if name in names)
            module = import_module(f"..{group}_commands", __name__)
            sub.set_defaults(run=getattr(module, f"run_{name}"))
            getattr(module, f"add_{name}_arguments")(sub)
    return parser


if __name__ == "__main__":
    sys.exit(main())


def nearest_ascii(character: str) -> str:
    """Return the nearest ASCII text of a character, or an escape sequence."""
    if character in _ASCII:
        return _ASCII[character]
    if "\udc80" <= character <= "\udcff":  # an undecodable byte of a file name
        return f"\\x{ord(character) - 0xDC00:02x}"
    plain = unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode()
    return plain or character.encode("ascii", "backslashreplace").decode()


def _replaced(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    text = error.object[error.start : error.end]
    return "".join(map(nearest_ascii, text)), error.end


@contextmanager
def showing_all() -> Iterator[None]:
    """Make standard output and error accept any text; unknown characters become ASCII."""
    codecs.register_error(_ERRORS, _replaced)
    before: list[tuple[Any, str | None]] = []
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # A replaced stream may lack this method.
            before.append((stream, stream.errors))
            stream.reconfigure(errors=_ERRORS)
    try:
        yield
    finally:
        for stream, errors in before:
            if not stream.closed:
                stream.reconfigure(errors=errors)
