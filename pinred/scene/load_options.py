"""Descriptions of the options of `pinred.load`, for scene files and the command line."""

from __future__ import annotations

from ..lie.groups import GROUPS
from ..system.loops.loop import KINDS
from .toml.schema import ByName, Either, Flag, Key, ListOf, Table, Text
from .toml.signal_tables import NUMBER, NUMBERS

LOOP = Table(
    {
        "frame_a": Key(Text((), "a link or frame"), "link or frame", required=True),
        "frame_b": Key(Text((), "a link or frame"), "other link or frame", required=True),
        "kind": Key(
            Text(KINDS),
            "3d: the origins coincide; 6d: the frames coincide; x, y or z: the origins and this "
            "axis coincide",
            default="3d",
        ),
        "name": Key(Text((), "a name"), "name in messages", default="frame_a = frame_b"),
        "coupled": Key(
            Flag(),
            "whether couplings replace the loop if its closed shapes are linear in independent "
            "joints",
            default="true",
        ),
    },
    "a closed loop",
)

LOAD = Table(
    {
        "group": Key(
            Text(tuple(GROUPS)),
            f"symmetry group: {', '.join(GROUPS)}",
            default="motion of the root joint",
            command="--group G",
        ),
        "gravity": Key(
            ListOf(NUMBER, 3),
            "gravity in the world frame [m/s²]",
            default="the robot's own",
            command="--gravity V1,V2,…",
        ),
        "lock": Key(
            Either(
                (
                    ListOf(Text((), "the name of a joint")),
                    ByName(Either((NUMBER, NUMBERS))),
                )
            ),
            "joints to lock at zero, or at the values stated by name [rad | m]; a ball has a "
            "rotation vector or a quaternion (x, y, z, w)",
            default="none",
            command="--lock J1,J2=VALUE,…",
        ),
        "balls": Key(
            Either((Flag(), ListOf(Text((), "the name of a ball or of a hinge")))),
            "three hinges at one point to merge into a ball, by name; true: all such hinges",
            default="false",
            command="--balls all or B1,B2,…",
        ),
        "loops": Key(
            Either((Text((), "a YAML file, or loops A=B:KIND,…"), ListOf(LOOP))),
            "closed kinematic loops, besides those of the robot's file: tables, or a YAML file "
            "relative to this file",
            default="none",
            command="--loops A=B:KIND,… or FILE.yaml",
        ),
        "root": Key(
            Text((), "the name of a body"),
            "root body of the robot, for MJCF files in which several bodies of the world move; "
            "base link, or model, of the robot, for SDF files with several",
            default="the only one that moves",
            command="--root BODY",
        ),
        "strict": Key(
            Flag(), "reject a robot that causes a warning", default="false", command="--strict"
        ),
        "meshes": Key(
            Either((Text((), "a folder"), ListOf(Text((), "a folder")))),
            "folders with the meshes of a URDF, or with the models that an SDF file includes; in "
            "scene files relative to them",
            default="folders above the robot's file",
            command="--meshes FOLDER",
        ),
    },
    "the options of pinred.load",
)
