"""Actions on a robot in a MuJoCo model that are not part of the reduction."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ..contents import LeftOut
from .joints import acts_on_joint
from .package import mujoco_package
from .passive import passive_left_out
from .tree import Tree
from .world import World


def acting_on(tree: Tree, outside: Sequence[str], *, gravcomp: bool) -> Iterator[LeftOut]:
    """Yield what acts on a robot and is not simulated, kind by kind.

    outside: names of constraints that tie it to what is not part of it.  gravcomp: whether
    gravity is compensated for a part of the bodies.
    """
    world, model = tree.world, tree.world.model
    joints = tree.free_joints
    moving = [body for body, carrier in tree.carriers.items() if carrier.joint > 0]
    kinds: dict[str, list[str]] = {"actuators": _actuators(tree)}
    kinds["equality constraints"] = [] if world.disabled("EQUALITY") else [*outside]
    kinds["tendons"] = [world.name("TENDON", k) for k in tendons_on(tree) if _pulls(world, k)]
    kinds |= passive_left_out(tree)
    kinds["joint limits"] = [
        world.joint_names[joint]
        for joint in joints
        if model.jnt_limited[joint] and not world.disabled("LIMIT")
    ]
    kinds["contact"] = _touching(tree)
    if (model.opt.density or model.opt.viscosity) and not world.no_passive_forces:
        kinds["fluid"] = [f"density {model.opt.density:g}, viscosity {model.opt.viscosity:g}"]
    if gravcomp:
        kinds["compensated gravity"] = [
            world.body_names[body] for body in moving if model.body_gravcomp[body]
        ]
    kinds["plugins"] = [world.body_names[body] for body in moving if model.body_plugin[body] >= 0]
    kinds["flexible bodies"] = [world.name("FLEX", k) for k in range(model.nflex)]
    kinds["other bodies"] = [*world.others]
    for what, names in kinds.items():
        if names:
            yield LeftOut(what, tuple(names))


def tendons_on(tree: Tree) -> list[int]:
    """Return the tendons whose length changes with the joints of a robot."""
    model, kinds = tree.world.model, mujoco_package().mjtWrap
    body_of = {
        int(kinds.mjWRAP_JOINT): model.jnt_bodyid,
        int(kinds.mjWRAP_SITE): model.site_bodyid,
        int(kinds.mjWRAP_SPHERE): model.geom_bodyid,
        int(kinds.mjWRAP_CYLINDER): model.geom_bodyid,
    }
    free = set(tree.free_joints)
    out = []
    for tendon in range(model.ntendon):
        first = int(model.tendon_adr[tendon])
        ends = set()
        for wrap in range(first, first + int(model.tendon_num[tendon])):
            kind, target = int(model.wrap_type[wrap]), int(model.wrap_objid[wrap])
            if kind == int(kinds.mjWRAP_JOINT):
                ends |= {-1, -2} if target in free else set()
            elif kind in body_of:
                body = int(body_of[kind][target])
                ends.add(tree.carriers[body].joint if body in tree.carriers else -3)
        if len(ends) > 1:  # it runs from one to another that moves against it
            out.append(tendon)
    return out


def _pulls(world: World, tendon: int) -> bool:
    model = world.model
    acts = {
        "SPRING": (model.tendon_stiffness[tendon], *model.tendon_stiffnesspoly[tendon]),
        "DAMPER": (model.tendon_damping[tendon], *model.tendon_dampingpoly[tendon]),
        "FRICTIONLOSS": (model.tendon_frictionloss[tendon],),
        "LIMIT": (model.tendon_limited[tendon],),
    }
    return any(any(numbers) and not world.disabled(what) for what, numbers in acts.items())


def _touching(tree: Tree) -> list[str]:
    """Return the shapes of moving bodies that can touch others."""
    world, model = tree.world, tree.world.model
    if world.disabled("CONTACT"):
        return []
    pairs = {int(geom) for geom in (*model.pair_geom1, *model.pair_geom2)}
    return [
        world.name("GEOM", geom)
        for geom in range(model.ngeom)
        if int(model.geom_bodyid[geom]) in tree.carriers
        and (model.geom_contype[geom] or model.geom_conaffinity[geom] or geom in pairs)
    ]


def _actuators(tree: Tree) -> list[str]:
    """Return the actuators that act on what moves; one of another body's is not the robot's."""
    world, model, kinds = tree.world, tree.world.model, mujoco_package().mjtTrn
    if world.disabled("ACTUATION"):
        return []
    joints, tendons = set(tree.free_joints), set(tendons_on(tree))
    out = []
    for k in range(model.nactuator):
        kind, target = int(model.actuator_trntype[k]), int(model.actuator_trnid[k, 0])
        if acts_on_joint(world, k):
            acts = target in joints
        elif kind == int(kinds.mjTRN_TENDON):
            acts = target in tendons
        elif kind in (int(kinds.mjTRN_SITE), int(kinds.mjTRN_SLIDERCRANK)):
            acts = int(model.site_bodyid[target]) in tree.carriers
        elif kind == int(kinds.mjTRN_BODY):
            acts = target in tree.carriers
        else:
            acts = True
        if acts:
            out.append(world.name("ACTUATOR", k))
    return out
