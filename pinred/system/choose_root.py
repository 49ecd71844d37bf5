"""Choose the root joint of a robot: its current root, or a new one of the requested group."""

from __future__ import annotations

import pinocchio as pin

from ..common.errors import ChoiceError, ModelError
from ..common.names import listed, quoted
from ..lie.group import Group
from ..lie.spatial_groups import SE3
from .joints import RootChain, is_shape_joint, motion_group, root_joint
from .rebuild import rebuild


def on_root(raw: pin.Model, group: Group | None, chain: RootChain | None) -> pin.Model:
    """Return the model with a root joint of the requested group: its current root, or a new one.

    Args:
        raw: Model.
        group: Requested group, or None for the group of the current root.
        chain: Consecutive joints at the root that form one joint, if any.
    Raises:
        ChoiceError: It is unclear whether the root link is fixed or floats.
        ModelError: The current root moves in another group.
    """
    root_group = _root_group(raw) if chain is None else chain.group
    if root_group is None:
        if group is None and raw.njoints > 1 and raw.inertias[0].mass == 0.0:
            raise ChoiceError(_unclear_root(raw), "group", ("SE3",))
        return rebuild(raw, root=root_joint(group or SE3))
    if group in (None, root_group):
        return raw if chain is None else rebuild(raw, root=root_joint(root_group), chain=chain)
    joints = list(raw.names)[1 : 2 if chain is None else chain.last + 1]
    locked = "' or '".join(joints)
    way_out = f"load it with group='{root_group}', or lock '{locked}'"
    if chain is None and raw.joints[1].nv == 1:
        way_out += ", or give the massless link above it a mass so that it can float"
    raise ModelError(
        f"group {group} was requested, but the root joint '{'+'.join(joints)}' of the model has "
        f"group {root_group}; {way_out}"
    )


def _unclear_root(raw: pin.Model) -> str:
    """Return the error message that asks whether a massless root link is fixed or floats."""
    links = [f.name for f in raw.frames if f.parentJoint == 0 and f.type == pin.FrameType.BODY]
    carried = [raw.names[i] for i in range(1, raw.njoints) if raw.parents[i] == 0]
    link = f"the root link {quoted(links[0])}" if links else "the root"
    return (
        f"{link} has no mass and carries several joints ({listed(carried)}): does it stand, or "
        "float? group='SE3' lets it float; as a ground it must carry one joint: lock the others, "
        "or give it a mass"
    )


def _root_group(raw: pin.Model) -> Group | None:
    """Return the group of the root joint in a model, or None if it needs a new root."""
    if raw.njoints < 2:
        return None
    group = motion_group(raw.joints[1])
    if not is_shape_joint(raw.joints[1]):
        return group
    anchored = raw.inertias[0].mass == 0.0
    carries_all = all(raw.parents[i] != 0 for i in range(2, raw.njoints))
    return group if anchored and carries_all else None
