"""Every word of SDF in the tables is honoured, reported, refused or harmless in a small file."""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pinred
from pinred.system.read_sdf import SdfRobot, read_sdf
from pinred.system.sdf_words import ANY, TABLES, Use, plugin_kind

pytestmark = pytest.mark.skipif(find_spec("pydrake") is None, reason="drake is not installed")

MASS = (
    "<inertial><pose>0.1 0 0.2 0 0 0</pose><mass>2</mass><inertia><ixx>.2</ixx><iyy>.3</iyy>"
    "<izz>.4</izz></inertia></inertial>"
)
BASE = f'<link name="base">{MASS}</link>'
ARM = f'<link name="arm"><pose>0.1 0.2 0.3 0 0.5 0</pose>{MASS}</link>'
TIP = f'<link name="tip"><pose>0.4 0.2 0.3 0 0.5 0</pose>{MASS}</link>'
TILTED = '<frame name="tilted"><pose>0.3 0 0 0.7 0.2 0</pose></frame>'
ENDS = "<parent>base</parent><child>arm</child>"
JOINT = f'<joint name="j" type="revolute">{ENDS}<axis><xyz>0 1 0</xyz></axis></joint>'
LAST = (
    '<joint name="k" type="revolute"><parent>arm</parent><child>tip</child><axis><xyz>1 0 0</xyz>'
    "{}</axis>{}</joint>"
)


MORE = '<joint name="more_joint" type="fixed"><parent>base</parent><child>{}</child></joint>'


def model(*parts: str, attributes: str = 'name="m"') -> str:
    """A model."""
    return f"<model {attributes}>{''.join(parts)}</model>"


def sdf(content: str, version: str = "1.12") -> str:
    """A file."""
    return f'<sdf version="{version}">{content}</sdf>'


# The contents of each table in a file, with {a} for an attribute and {e} for an element.
TEMPLATES = {
    "sdf": "<sdf {a}>{e}</sdf>",
    "world": sdf("<world {a}>" + model(BASE, ARM, JOINT) + "{e}</world>"),
    "physics": sdf(
        '<world name="w"><physics type="ode" {a}>{e}</physics>'
        + model(BASE, ARM, JOINT)
        + "</world>"
    ),
    "model": sdf(model(BASE, ARM, TIP, TILTED, JOINT, "{e}", attributes="{a}")),
    "include": sdf(model(BASE, TILTED, "<include {a}>{e}</include>", MORE.format("p::part"))),
    "pose": sdf(model(BASE, TILTED, '<link name="arm"><pose {a}>1 2 3 0 0 1</pose></link>', JOINT)),
    "frame": sdf(
        model(BASE, "<frame {a}>{e}</frame>", TILTED)
        .replace("</model>", '<link name="arm"><pose relative_to="f">1 2 3 0 0 1</pose></link>')
        + JOINT
        + "</model>"
    ),
    "link": sdf(model(BASE, "<link {a}>{e}</link>", JOINT)),
    "inertial": sdf(
        model(
            '<link name="base"><collision name="c"><geometry><box><size>1 2 3</size></box>'
            "</geometry></collision><inertial {a}>{e}</inertial></link>"
        )
    ),
    "inertia": sdf(model('<link name="base"><inertial><inertia>{e}</inertia></inertial></link>')),
    "joint": sdf(model(BASE, ARM, TIP, LAST.format("", ""), "<joint {a}>{e}</joint>")),
    "joint physics": sdf(
        model(BASE, ARM, JOINT.replace("<axis", "<physics {a}>{e}</physics><axis"))
    ),
    "ode": sdf(
        model(BASE, ARM, JOINT.replace("<axis", "<physics><ode>{e}</ode></physics><axis"))
    ),
    "axis": sdf(
        model(BASE, ARM, TIP, LAST.format("", ""), JOINT.replace("<xyz>0 1 0</xyz>", "{e}"))
    ),
    "xyz": sdf(model(BASE, ARM, TILTED, JOINT.replace("<xyz>", "<xyz {a}>"))),
    "dynamics": sdf(
        model(BASE, ARM, JOINT.replace("</xyz>", "</xyz><dynamics>{e}</dynamics>"))
    ),
    "limit": sdf(model(BASE, ARM, JOINT.replace("</xyz>", "</xyz><limit>{e}</limit>"))),
    "mimic": sdf(model(BASE, ARM, TIP, JOINT, LAST.format("<mimic {a}>{e}</mimic>", ""))),
    "drake:mimic": sdf(model(BASE, ARM, TIP, JOINT, LAST.format("", "<drake:mimic {a}/>"))),
    "drake:joint": sdf(model(BASE, ARM, "<drake:joint {a}>{e}</drake:joint>")),
    "drake:ball_constraint": sdf(
        model(
            BASE, ARM, TIP, JOINT, LAST.format("", ""),
            "<drake:ball_constraint>{e}</drake:ball_constraint>",
        )
    ),
}  # fmt: skip
# What the other words of a table need beside the word under test: {table: {word: text}}.
NEEDED: dict[str, dict[str, str]] = {
    "sdf": {"@version": 'version="1.9"', "model": model(BASE)},
    "world": {"@name": 'name="w"'},
    "model": {"@name": 'name="m"', "joint": LAST.format("", "")},
    "include": {"uri": "<uri>part.sdf</uri>"},
    "frame": {"@name": 'name="f"'},
    "link": {"@name": 'name="arm"'},
    "joint": {
        "@name": 'name="j"', "@type": 'type="revolute"', "parent": "<parent>base</parent>",
        "child": "<child>arm</child>", "axis": "<axis><xyz>0 1 0</xyz></axis>",
    },
    "axis": {"xyz": "<xyz>0 1 0</xyz>"},
    "mimic": {"@joint": 'joint="j"'},
    "drake:mimic": {
        "@joint": 'joint="j"', "@multiplier": 'multiplier="2"', "@offset": 'offset="1"',
    },
    "drake:joint": {
        "@name": 'name="j"', "@type": 'type="planar"', "drake:parent":
        "<drake:parent>base</drake:parent>", "drake:child": "<drake:child>arm</drake:child>",
        "drake:damping": "<drake:damping>1 1 1</drake:damping>",
    },
    "drake:ball_constraint": {
        f"drake:ball_constraint_{key}": (
            f"<drake:ball_constraint_{key}>{value}</drake:ball_constraint_{key}>"
        )
        for key, value in {
            "body_A": "base", "p_AP": "0 0 1", "body_B": "tip", "p_BQ": "0 1 1",
        }.items()
    },
}  # fmt: skip
# Words in the file, if they are not <word>1</word>.
SAMPLES: dict[tuple[str, str], str] = {
    ("sdf", "world"): '<world name="w"><model name="n">' + BASE + ARM + JOINT + "</model></world>",
    ("sdf", "include"): "<include><uri>part.sdf</uri></include>",
    ("world", "model"): model(BASE, attributes='name="n"'),
    ("world", "include"): "<include><uri>part.sdf</uri></include>",
    ("world", "joint"): (
        '<joint name="w" type="fixed"><parent>world</parent><child>m::base</child></joint>'
    ),
    ("world", "frame"): (
        '<frame name="f"/><joint name="w" type="fixed"><parent>f</parent><child>m::base</child>'
        "</joint>"
    ),
    ("world", "gravity"): "<gravity>1 2 3</gravity>",
    ("world", "wind"): "<wind><linear_velocity>1 0 0</linear_velocity></wind>",
    ("world", "physics"): "<physics><gravity>1 2 3</gravity></physics>",
    ("physics", "gravity"): "<gravity>1 2 3</gravity>",
    ("model", "@canonical_link"): 'canonical_link="arm"',
    ("model", "@placement_frame"): 'placement_frame="nowhere"',
    ("model", "static"): "<static>true</static>",
    ("model", "pose"): '<pose relative_to="nowhere">1 2 3 0 0 0</pose>',
    ("model", "link"): '<link name="more"/>' + MORE.format("more"),
    ("model", "frame"): (
        '<frame name="f"><pose>1 0 0 0 0 0</pose></frame><link name="more"/><joint name="l" '
        'type="fixed"><parent>f</parent><child>more</child></joint>'
    ),
    ("model", "model"): '<model name="n"><link name="more"/></model>' + MORE.format("n::more"),
    ("model", "include"): "<include><uri>part.sdf</uri></include>" + MORE.format("p::part"),
    ("model", "drake:joint"): (
        '<link name="more"/><drake:joint name="d" type="planar"><drake:parent>base</drake:parent>'
        "<drake:child>more</drake:child><drake:damping>0 0 0</drake:damping></drake:joint>"
    ),
    ("model", "drake:ball_constraint"): (
        "<drake:ball_constraint>" + "".join(NEEDED["drake:ball_constraint"].values())
        + "</drake:ball_constraint>"
    ),
    ("include", "@merge"): 'merge="true"',
    ("include", "pose"): '<pose relative_to="nowhere">1 2 3 0 0 0</pose>',
    ("include", "name"): "<name>other</name>",
    ("include", "placement_frame"): "<placement_frame>nowhere</placement_frame><pose/>",
    ("include", "static"): "<static>true</static>",
    ("pose", "@relative_to"): 'relative_to="tilted"',
    ("pose", "@frame"): 'frame="tilted"',
    ("pose", "@degrees"): 'degrees="true"',
    ("pose", "@rotation_format"): 'rotation_format="quat_xyzw"',
    ("frame", "@attached_to"): 'attached_to="nowhere"',
    ("frame", "pose"): "<pose>1 2 3 0 0 0</pose>",
    ("link", "pose"): "<pose>1 2 3 0 0 0</pose>",
    ("link", "inertial"): MASS,
    ("link", "gravity"): "<gravity>false</gravity>",
    ("link", "collision"): '<collision name="c"/>',
    ("inertial", "pose"): "<pose>1 2 3 0 0 0</pose>",
    ("inertial", "@auto"): 'auto="true"',
    ("inertial", "density"): "<density>7</density>",
    ("inertial", "inertia"): "<inertia><ixx>1.5</ixx></inertia>",
    ("inertial", "mass"): "<mass>3</mass>",
    **{("inertia", key): f"<{key}>1.5</{key}>" for key in ("ixx", "iyy", "izz")},
    **{("inertia", key): f"<{key}>.2</{key}>" for key in ("ixy", "ixz", "iyz")},
    ("joint", "pose"): "<pose>1 2 3 0 0 0</pose>",
    ("joint", "screw_thread_pitch"): "<screw_thread_pitch>3</screw_thread_pitch>",
    ("joint", "axis2"): (
        "<axis2><xyz>1 0 0</xyz><dynamics><friction>1</friction></dynamics></axis2>"
    ),
    ("joint", "physics"): "<physics><ode><max_force>1</max_force></ode></physics>",
    ("joint", "drake:rotor_inertia"): "<drake:rotor_inertia>2</drake:rotor_inertia>",
    ("joint", "drake:gear_ratio"): "<drake:gear_ratio>3</drake:gear_ratio>",
    ("joint", "drake:mimic"): '<drake:mimic joint="k" multiplier="2" offset="0"/>',
    ("joint physics", "ode"): "<ode><max_force>1</max_force></ode>",
    ("axis", "xyz"): "<xyz>1 0 0</xyz>",
    ("axis", "use_parent_model_frame"): (
        "<use_parent_model_frame>true</use_parent_model_frame>"
    ),
    ("axis", "dynamics"): "<dynamics><damping>2</damping></dynamics>",
    ("axis", "limit"): "<limit><lower>-2</lower></limit>",
    ("axis", "mimic"): '<mimic joint="k"><multiplier>2</multiplier></mimic>',
    ("xyz", "@expressed_in"): 'expressed_in="tilted"',
    ("mimic", "multiplier"): "<multiplier>2</multiplier>",
    ("mimic", "@axis"): 'axis="axis2"',
    ("limit", "lower"): "<lower>-1</lower>",
    ("drake:joint", "@type"): 'type="planar"',
    ("drake:joint", "drake:is_periodic"): "<drake:is_periodic>true</drake:is_periodic>",
}  # fmt: skip
# What stands in the file beside the word, with and without it.
BESIDE = {
    ("model", "@canonical_link"): (
        "<joint name='w' type='fixed'><parent>world</parent><child>__model__</child></joint>"
    ),
    ("mimic", "reference"): "<multiplier>2</multiplier>",
    ("dynamics", "spring_reference"): "<spring_stiffness>1</spring_stiffness>",
    ("joint", "drake:gear_ratio"): "<drake:rotor_inertia>2</drake:rotor_inertia>",
}
# Words that need another version of SDF, or another text elsewhere.
OLD = [('"1.12"', '"1.6"')]
SCREW = [('name="j" type="revolute"', 'name="j" type="screw"')]
CHANGES: dict[tuple[str, str], list[tuple[str, str]]] = {
    ("sdf", "world"): [(model(BASE), "")],
    ("sdf", "include"): [(model(BASE), "")],
    ("pose", "@frame"): OLD,
    ("pose", "@rotation_format"): [("1 2 3 0 0 1", "1 2 3 0 0 1 0")],
    ("link", "frame"): OLD,
    ("joint", "frame"): OLD,
    ("inertial", "frame"): OLD,
    ("axis", "use_parent_model_frame"): [*OLD, ("0 1 0</xyz>", "1 0 0</xyz>")],
    ("joint", "screw_thread_pitch"): SCREW,
    ("joint", "thread_pitch"): SCREW,
    ("inertial", "density"): [("<inertial >", '<inertial auto="true">')],
    ("inertial", "auto_inertia_params"): [("<inertial >", '<inertial auto="true">')],
    ("include", "@merge"): [("p::part", "part")],
    ("include", "name"): [("p::part", "other::part")],
    ("mimic", "@axis"): [
        ('name="j" type="revolute"', 'name="j" type="universal"'),
        ("0</xyz></axis>", "0</xyz></axis><axis2><xyz>1 0 0</xyz></axis2>"),
    ],
}
# Words that make the file invalid here, and the message.
ERRORS = {
    ("world", "model"): "several robots (m, n)",
    ("world", "include"): "several robots (m, p)",
}
WORDS = [(table, key) for table, words in TABLES.items() for key in words]
PART = sdf(model(f'<link name="part">{MASS}</link>', attributes='name="p"'))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a model to include."""
    path = tmp_path_factory.mktemp("sdf")
    (path / "part.sdf").write_text(PART, "utf-8")
    return path


@pytest.mark.slow
@pytest.mark.parametrize(("table", "key"), WORDS)
@pytest.mark.sampled
def test_word_is_honoured_reported_or_harmless(folder: Path, table: str, key: str) -> None:
    """A file with the word differs from the same file without it as the table says."""
    word = TABLES[table][key]
    before, after = (outcome(folder, file(table, key, used)) for used in (False, True))
    if word.use is Use.REFUSED:
        assert isinstance(after, str)
        assert f"<{key}> is not supported; {word.kind}" in after
        assert "line 1: " in after
    elif word.use is Use.LEFT_OUT:
        assert isinstance(before, tuple)
        assert isinstance(after, tuple)
        assert before[0] == after[0]
        assert len(after[1]) == len(before[1]) + 1
        kind, names = next(entry for entry in after[1] if entry not in before[1])
        assert kind == word.kind
        assert "line 1" in names[0]
    elif word.use is Use.HARMLESS:
        assert before == after
    else:
        assert before != after
        expected = "nowhere" if "nowhere" in SAMPLES.get((table, key), "") else ""
        if expected := ERRORS.get((table, key), expected):
            assert expected in str(after)
        else:
            assert not isinstance(after, str), after


def file(table: str, key: str, used: bool) -> str:
    """Return a file with or without a word of a table."""
    name = "anything" if key.strip("@") == ANY else key.strip("@")
    default = f'{name}="1"' if key.startswith("@") else f"<{name}>1</{name}>"
    sample = SAMPLES.get((table, key), NEEDED.get(table, {}).get(key, default))
    parts = NEEDED.get(table, {}) | ({key: sample} if used else {})
    if not used:
        parts = {name: text for name, text in parts.items() if name != key}
    attributes = " ".join(text for name, text in parts.items() if name.startswith("@"))
    elements = "".join(text for name, text in parts.items() if not name.startswith("@"))
    elements += BESIDE.get((table, key), "")
    text = TEMPLATES[table].replace("{a}", attributes).replace("{e}", elements)
    for old, new in CHANGES.get((table, key), []):
        assert old in text
        text = text.replace(old, new)
    return text


@cache
def outcome(folder: Path, text: str) -> str | tuple[Any, ...]:
    """Return the message of an error, or the numbers of a robot and what is left out."""
    path = folder / "robot.sdf"
    path.write_text(text, "utf-8")
    try:
        robot = read_sdf(path)
    except pinred.PinredError as error:
        return str(error)
    return numbers(robot), [(left.what, left.names) for left in robot.left_out]


def numbers(robot: SdfRobot) -> tuple[Any, ...]:
    """Return everything that a robot consists of, rounded."""
    model = robot.model
    q = pin.integrate(model, pin.neutral(model), np.linspace(0.3, 0.7, model.nv))
    arrays = (
        np.triu(pin.crba(model, model.createData(), q)),
        *(inertia.toDynamicParameters() for inertia in model.inertias),
        *(M.homogeneous for M in model.jointPlacements), model.gravity.linear, model.damping,
        model.upperDryFrictionLimit, model.lowerPositionLimit, model.upperPositionLimit,
        model.upperVelocityLimit, model.upperEffortLimit, model.armature,
    )  # fmt: skip
    frames = [(str(f.name), f.parentJoint, f.placement.homogeneous) for f in model.frames]
    return (
        [np.round(array, 10).tolist() for array in arrays],
        [(name, joint, np.round(matrix, 10).tolist()) for name, joint, matrix in frames],
        [*map(str, robot.couplings)], [*map(str, robot.loops)], robot.springs, robot.warning,
    )  # fmt: skip


def test_unknown_words_are_reported_with_their_lines(tmp_path: Path) -> None:
    """An element and an attribute that no table has."""
    path = tmp_path / "robot.sdf"
    path.write_text(
        sdf(model(BASE.replace('"base"', '"base" colour="red"'), "\n<thruster/>")), "utf-8"
    )
    with pytest.warns(pinred.LeftOutWarning, match=r"unknown words \(2\)"):
        system = pinred.load(path)
    assert [left.names for left in system.left_out if left.what == "unknown words"] == [
        ("base: attribute colour of <link> (line 1)", "<thruster> in <model> (line 2)")
    ]


@pytest.mark.parametrize(("value", "number"), [("true", 1), ("false", 0)])
def test_words_of_older_versions_are_unknown_to_newer_ones(
    tmp_path: Path, value: str, number: int
) -> None:
    """Gazebo ignores them; without effect they are not reported."""
    word = f"</xyz><use_parent_model_frame>{value}</use_parent_model_frame>"
    path = tmp_path / "robot.sdf"
    path.write_text(sdf(model(BASE, ARM, JOINT.replace("</xyz>", word)), "1.9"), "utf-8")
    kinds = [left.what for left in read_sdf(path).left_out]
    assert kinds.count("unknown words") == number


@pytest.mark.parametrize(
    ("filename", "kind"),
    [
        ("gz-sim-physics-system", ""),
        ("libignition-gazebo6-scene-broadcaster-system.so", ""),
        ("gz-sim-buoyancy-system", "buoyancy"),
        ("gz-sim-hydrodynamics-system", "plugins"),
        ("libgazebo_ros_diff_drive.so", "plugins"),
    ],
)
def test_plugin_that_may_act_is_reported(filename: str, kind: str) -> None:
    """Systems of Gazebo that only observe are not."""
    assert plugin_kind(filename) == kind
