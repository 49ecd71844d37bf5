"""The reference of the command line, from its argument parsers."""

from __future__ import annotations

import argparse

from docstring_markdown import code, escape, table

from pinred.cli import command_line


def pages() -> dict[str, str]:
    """Return the page of all commands."""
    parts = [
        "# Command line\n\nLook up the options of each command. `pinred COMMAND --help` prints the "
        "same. Exit codes: 0 if all is well, 1 if a comparison or an integration fails, 2 on "
        "invalid input, 3 if a comparison cannot tell, 130 after Ctrl-C.\n"
    ]
    for name, text in command_line.COMMANDS.items():
        parts += [f"## `pinred {name}`\n", escape(text[0].upper() + text[1:]) + ".\n"]
        parts.append(describe(find_parser(name)))
    return {"cli": "\n".join(parts)}


def find_parser(name: str) -> argparse.ArgumentParser:
    """Return the parser of a command."""
    commands = subcommands(command_line._parser([name]))
    return commands[name]


def subcommands(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Return the parsers of the subcommands by name."""
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


def describe(parser: argparse.ArgumentParser) -> str:
    """Return usage and tables of arguments, with those of subcommands."""
    usage = " ".join(parser.format_usage().removeprefix("usage: ").split())
    parts = [f"```text\n{wrap(usage)}\n```\n"]
    rows = [row_of(action) for action in parser._actions if is_shown(action)]
    if rows:
        parts.append(table(("argument", "meaning"), rows))
    for name, child in subcommands(parser).items():
        parts += [f"### `{parser.prog} {name}`\n", escape(child.description or "") + "\n"]
        parts.append(describe(child))
    return "\n".join(parts)


def is_shown(action: argparse.Action) -> bool:
    """Return whether an argument belongs into the table."""
    hidden = action.help == argparse.SUPPRESS or "--help" in action.option_strings
    return not hidden and not isinstance(action, argparse._SubParsersAction)


def row_of(action: argparse.Action) -> tuple[str, str]:
    """Return names with value, and the meaning with the choices."""
    value = action.metavar or (action.dest.upper() if action.nargs != 0 else "")
    if isinstance(value, tuple):
        value = " ".join(value)
    if action.choices and action.metavar is None:
        value = "{" + ",".join(map(str, action.choices)) + "}"
    names = ", ".join(action.option_strings) or value
    shown = f"{names} {value}" if action.option_strings and value else names
    text = (action.help or "") % {**vars(action), "prog": "pinred"}
    return code(shown), escape(text, in_table=True)


def wrap(usage: str, width: int = 92) -> str:
    """Return a usage message in lines of at most a width, split between arguments."""
    lines = [""]
    for word in usage.replace("] [", "]\n[").split("\n"):
        if len(lines[-1]) + len(word) > width:
            lines.append("   ")
        lines[-1] += (" " if lines[-1] else "") + word
    return "\n".join(lines)
