"""Division of a module of LLVM into parts, for which several threads generate machine code.

The functions keep their instructions.  Functions that only their module could call become visible
to the other parts; calls have the same instructions for both, because the code model of machine
code in memory permits functions at any address.
"""

from __future__ import annotations

import re

import llvmlite.binding as llvm

# Length of a part's text above which it gets no further function.  A part takes some milliseconds
# besides the time for its functions, which is about a second per megabyte of text.
_LENGTH = 100_000


def divide(module: llvm.ModuleRef) -> list[str]:
    """Return LLVM assembly of parts of a module, the longest first.

    Constants are part of all parts.

    Args:
        module: The module, whose functions are renamed. Its global variables are constants.
    Returns:
        The parts; no function belongs to two of them.
    """
    for k, function in enumerate(f for f in module.functions if not f.is_declaration):
        if function.linkage in (llvm.Linkage.internal, llvm.Linkage.private):
            function.name = f"part_{k}"
            function.linkage, function.visibility = "external", "hidden"
    # A module is global values, definitions that each start and end at the start of a line,
    # and attributes.
    rest, *definitions = re.split(r"^(?=define )", str(module), flags=re.MULTILINE)
    functions = []
    for definition in definitions:
        end = definition.index("\n}\n") + 3
        functions.append(definition[:end])
        rest += definition[end:]
    declared = ["declare" + f[len("define") : f.index(" {\n")] + "\n" for f in functions]
    return [
        rest + "".join(functions[k] if k in group else declared[k] for k in range(len(functions)))
        for group in _groups([len(function) for function in functions])
    ]


def _groups(lengths: list[int]) -> list[set[int]]:
    """Return indices of functions that are parts together, the longest part first."""
    groups: list[set[int]] = []
    length = _LENGTH
    for k in sorted(range(len(lengths)), key=lambda k: -lengths[k]):
        if length >= _LENGTH:
            groups.append(set())
            length = 0
        groups[-1].add(k)
        length += lengths[k]
    return groups
