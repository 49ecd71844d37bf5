"""The reference of public names, from signatures and docstrings."""

from __future__ import annotations

import inspect
import re
import sys
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

sys.path.append(str(Path(__file__).parents[2] / "tests/helpers"))

import site_pages
from api_index import NAMESPACES, public_names
from docstring_markdown import code, escape, parse, table

ROOT = Path(__file__).parents[2]
_SHORT = (("numpy.typing.", ""), ("collections.abc.", ""), ("typing.", ""))


def pages() -> dict[str, str]:
    """Return a page for each task and each function of `pinred`, and one per other namespace."""
    names: dict[str, dict[str, Any]] = {namespace: {} for namespace in NAMESPACES}
    for full, value in public_names().items():
        namespace, _, name = full.rpartition(".")
        names[namespace][name] = value
    made: dict[str, str] = {}
    for task in TASKS:
        members = {n: v for n, v in names["pinred"].items() if task_of(v) == task.page}
        made |= task_pages(task, members)
    for namespace, members in names.items():
        if namespace != "pinred":
            made[f"api/{namespace.replace('.', '_')}"] = page(namespace, members, namespace)
    return made


@dataclass(frozen=True)
class Task:
    """A group of names that one task needs.

    Attributes:
        page: Name of its page.
        title: Title of its page.
        modules: Beginnings of the modules, below `pinred`, that define its names.
    """

    page: str
    title: str
    modules: tuple[str, ...]


TASKS = (
    Task("load", "Load and look at robots", ("system.", "analysis.inspection")),
    Task("simulate", "Simulate", (
        "scene.", "simulation.simulate", "simulation.trajectory", "simulation.balances",
        "simulation.events", "simulation.flow_map", "integrators.", "common.parameter", "kernels.",
    )),
    Task("compare", "Compare with the full simulation", ("judge.",)),
    Task("connections", "Connections, phases and gaits", (
        "analysis.connections", "analysis.full_reduction", "analysis.phases", "planning.",
        "reduction.",
    )),
    Task("impacts", "Stops, captures, releases and landings", (
        "scene.stop", "simulation.contact", "simulation.impacts", "judge.impact_checks",
    )),
    Task("stability", "Steady motions and stability", (
        "analysis.equilibria", "analysis.stability",
    )),
    Task("space_arms", "Space arms", (
        "analysis.floating_arm", "analysis.reaction_free_path",
    )),
    Task("batches", "Batches and sweeps", (
        "simulation.simulate_many", "simulation.members", "sweeps.",
    )),
    Task(
        "figures_and_files",
        "Figures, playback and files",
        ("views.", "simulation.read_recording"),
    ),
    Task("errors", "Errors and warnings", ("common.errors",)),
)  # fmt: skip


def task_of(value: Any) -> str:
    """Return the page of the task to which a public name belongs.

    Raises:
        LookupError: No task or several tasks name its module.
    """
    module = value.__module__.removeprefix("pinred.") + "."
    found = [(len(m), t.page) for t in TASKS for m in t.modules if module.startswith(m)]
    if not found:
        raise LookupError(f"no task has the module {module} of {value.__name__}")
    return max(found)[1]


def task_pages(task: Task, members: dict[str, Any]) -> dict[str, str]:
    """Return the page of a task, and those of its functions."""
    functions = {n: v for n, v in members.items() if not inspect.isclass(v)}
    classes = {n: v for n, v in members.items() if n not in functions}
    both = functions | classes  # functions first
    meanings = {n: parse(v.__doc__).prose.partition("\n\n")[0] for n, v in both.items()}
    rows = [
        (f"{{py:obj}}`~pinred.{name}`", escape(meaning, in_table=True))
        for name, meaning in meanings.items()
    ]
    parts = [f"# {task.title}\n", table(("name", "meaning"), rows)]
    if functions:
        listed = "\n".join(f"functions/{name}" for name in functions)
        parts.append(f"```{{toctree}}\n:hidden:\n\n{listed}\n```\n")
    parts += [entry(f"pinred.{name}", value) for name, value in classes.items()]
    made = {f"api/{task.page}": "\n".join(parts)}
    for name, value in functions.items():
        text = f"# {name}\n\n{entry(f'pinred.{name}', value)}\n{example_of(name)}"
        made[f"api/functions/{name}"] = text
    return made


def example_of(name: str) -> str:
    """Return the shortest code block of the pages that calls a function, or nothing."""
    found = [
        (block.count("\n"), path.relative_to(ROOT).as_posix(), block)
        for path in [ROOT / "README.md", *site_pages.sources()]
        for block in site_pages.python_blocks(path.read_text("utf-8"))
        if re.search(rf"\bpinred\.{name}\(", block)
    ]
    if not found:
        return ""
    _, where, block = min(found)
    link = "index" if where == "README.md" else where.removeprefix("docs/").removesuffix(".md")
    return f"## Example\n\nFrom [](../../../{link}.md):\n\n```python\n{block}```\n"


def page(namespace: str, members: dict[str, Any], title: str) -> str:
    """Return the page of some names of a namespace."""
    lead = f"Look up what each name in `{namespace}` takes and returns."
    listed = ", ".join(f"{{py:obj}}`~{namespace}.{name}`" for name in members)
    parts = [f"# {title}\n\n{lead}\n\n{listed}\n"]
    parts += [entry(f"{namespace}.{name}", value) for name, value in members.items()]
    return "\n".join(parts)


def entry(full: str, value: Any) -> str:
    """Return the entry of a name."""
    if inspect.isclass(value):
        return class_entry(full, value)
    if callable(value):
        return directive("function", full + call(value), function_body(value), 4)
    return directive("data", full, f"A constant of type `{type(value).__name__}`.\n", 4)


def class_entry(full: str, value: type) -> str:
    """Return the entry of a class, with its methods and properties."""
    doc = parse(value.__doc__)
    if issubclass(value, Exception):
        return directive("exception", full, escape(doc.prose) + "\n", 4)
    start = parse(None if is_dataclass(value) else value.__init__.__doc__)
    described = {**start.entries("Args"), **doc.entries("Attributes"), **doc.entries("Args")}
    parts = [escape(doc.prose), ""]
    parts.append(parameter_table(value, described))
    if is_dataclass(value):
        parts.append(field_table(value, described))
    parts.append(tail(start))
    bases = [base for base in reversed(value.__mro__) if base.__module__.startswith("pinred.")]
    members = {name: member for base in bases for name, member in vars(base).items()}
    for name, member in sorted(members.items()):
        if name.startswith("_") and name != "__call__":
            continue
        parts.append(member_entry(full, name, member))
    return directive("class", full + call(value), "\n".join(parts), 5)


def member_entry(owner: str, name: str, member: Any) -> str:
    """Return the entry of a method or a property; other members have none."""
    if isinstance(member, property) or type(member).__name__ == "cached_property":
        function = member.fget if isinstance(member, property) else member.func
        body = escape(parse(function.__doc__).prose) + "\n" + tail(parse(function.__doc__))
        return directive("property", f"{owner}.{name}", body, 4)
    function = getattr(member, "__func__", member)
    if not inspect.isfunction(function):
        return ""
    kind = {staticmethod: "staticmethod", classmethod: "classmethod"}.get(type(member), "method")
    return directive(kind, f"{owner}.{name}" + call(function), function_body(function), 4)


def directive(kind: str, signature: str, body: str, colons: int) -> str:
    """Return a description of a Python object."""
    fence = ":" * colons
    return f"{fence}{{py:{kind}}} {signature}\n\n{body}\n{fence}\n"


def call(function: Any) -> str:
    """Return the names of the parameters in parentheses; optional ones have `=…`."""
    parts: list[str] = []
    previous = None
    for p in parameters(function):
        if p.kind is p.KEYWORD_ONLY and previous not in (p.KEYWORD_ONLY, p.VAR_POSITIONAL):
            parts.append("*")
        stars = "*" if p.kind is p.VAR_POSITIONAL else "**" if p.kind is p.VAR_KEYWORD else ""
        parts.append(stars + p.name + ("" if p.default is p.empty else "=…"))
        previous = p.kind
    return f"({', '.join(parts)})"


def parameters(function: Any) -> list[inspect.Parameter]:
    """Return the parameters without `self`."""
    try:
        found = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return []
    return [p for p in found if p.name not in ("self", "cls") and not p.name.startswith("_")]


def function_body(function: Any) -> str:
    """Return description, table of parameters, and what is returned and raised."""
    doc = parse(function.__doc__)
    described = doc.entries("Args")
    return "\n".join([escape(doc.prose), "", parameter_table(function, described), tail(doc)])


def parameter_table(function: Any, described: dict[str, str]) -> str:
    """Return the table of parameters, or nothing."""
    rows = [
        (code(p.name), code(type_of(p.annotation)), default_of(p),
         escape(described.get(p.name, ""), in_table=True))
        for p in parameters(function)
    ]  # fmt: skip
    return table(("parameter", "type", "default", "meaning"), rows) if rows else ""


def field_table(value: type, described: dict[str, str]) -> str:
    """Return the table of the fields that are no parameters, or nothing."""
    rows = [
        (code(f.name), code(type_of(f.type)), escape(described.get(f.name, ""), in_table=True))
        for f in fields(value)
        if not f.init and not f.name.startswith("_")
    ]
    return table(("attribute", "type", "meaning"), rows) if rows else ""


def type_of(annotation: Any) -> str:
    """Return an annotation as text."""
    if annotation is inspect.Parameter.empty:
        return ""
    text = annotation if isinstance(annotation, str) else getattr(annotation, "__name__", "")
    text = text or str(annotation)
    for long, short in _SHORT:
        text = text.replace(long, short)
    return text


def default_of(parameter: inspect.Parameter) -> str:
    """Return a default as code; nothing if there is none."""
    if parameter.default is parameter.empty:
        return ""
    text = re.sub(r" at 0x[0-9a-f]+|<factory>", "", repr(parameter.default))
    return "" if not text or text.startswith("<") else code(text)


def tail(doc: Any) -> str:
    """Return the sections on what is returned and raised."""
    parts = [
        f"**{section}** " + escape("\n".join(map(str.strip, lines))) + "\n"
        for section, lines in doc.sections.items()
        if section in ("Returns", "Yields")
    ]
    if raised := doc.entries("Raises"):
        rows = [(code(n), escape(t, in_table=True)) for n, t in raised.items()]
        parts.append(table(("raises", "when"), rows))
    return "\n".join(parts)
