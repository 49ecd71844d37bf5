"""MJCF constructs that concern masses and motions, each as a piece of a robot file.

An arm is a body that is inserted into the carrying body of a robot. N in its text is replaced by
the number of the arm, so that names differ. A head is inserted before the world.
"""

from __future__ import annotations

import numpy as np

INERTIAL = '<inertial pos=".1 -.2 .05" mass="1.3" diaginertia=".02 .03 .04"/>'
BOX = '<geom type="box" size=".1 .2 .05" pos=".1 .02 -.03"/>'
HINGE = '<joint axis="1 2 -1" pos=".05 .1 0"/>'
SLIDE = '<joint type="slide" axis="0 1 1"/>'
TETRAHEDRON = "0 0 0 .3 0 0 0 .4 0 .05 .1 .5"
OPEN = "0 0 0 .3 0 0 0 .4 0 .05 .1 .5 .4 .4 .1"


def body(content: str = BOX, joints: str = HINGE, attributes: str = 'pos=".1 .2 .3"') -> str:
    """Return a body with joints and mass."""
    return f"<body {attributes}>{joints}{content}</body>"


def geom(attributes: str) -> str:
    """Return a body with one geom."""
    return body(f"<geom {attributes}/>")


def mesh(
    attributes: str = "", on_geom: str = 'type="mesh"', vertices: str = TETRAHEDRON
) -> tuple[str, str]:
    """Return a head with a mesh, and a body with a geom of it."""
    asset = f'<asset><mesh name="meshN" vertex="{vertices}" {attributes}/></asset>'
    return asset, geom(f'mesh="meshN" pos=".1 0 .2" euler="10 20 30" {on_geom}')


# Head and arm of each construct, by its name.
CONSTRUCTS: dict[str, tuple[str, str]] = {
    # where bodies are
    "no attributes": ("", body(attributes="")),
    "place": ("", body(attributes='pos="1 2 -3"')),
    "quaternion": ("", body(attributes='quat="1 2 3 4"')),
    "axis and angle": ("", body(attributes='axisangle="1 1 0 40"')),
    "Euler angles": ("", body(attributes='euler="20 30 40"')),
    "x and y axes": ("", body(attributes='xyaxes="1 1 0 0 1 1"')),
    "z axis": ("", body(attributes='zaxis="1 2 3"')),
    "frame": ("", f'<frame pos=".1 .2 .3" euler="10 20 30">{body()}</frame>'),
    "frames in frames": (
        "",
        f'<frame pos="1 0 0" euler="0 90 0"><frame quat="1 1 0 0">{body()}</frame></frame>',
    ),
    "frame in a body": (
        "",
        f'<body pos="0 0 1"><frame pos=".1 0 0" euler="0 30 0">{HINGE}{BOX}</frame></body>',
    ),
    "replicated": (
        "",
        f'<replicate count="3" offset=".1 .2 0" euler="0 10 0">{body()}</replicate>',
    ),
    "replicated shape": (
        "",
        body('<replicate count="4" offset="0 0 .3" euler="0 0 20"><geom size=".1"/></replicate>'),
    ),
    "attached": (
        "",
        f'<body name="armN" pos="1 0 0">{HINGE}{BOX}</body>'
        '<frame pos="0 1 0" euler="30 0 0"><attach body="armN" prefix="againN_"/></frame>',
    ),
    "class of children": (
        '<default><default class="softN"><joint axis="0 1 0" armature=".3"/>'
        '<geom density="300"/></default></default>',
        f'<body childclass="softN" pos="0 0 .2"><joint/>{BOX}</body>',
    ),
    "unnamed fixed bodies": (
        "",
        body(f'{BOX}<body pos="0 .2 0">{BOX}</body><body pos="0 0 .3" euler="0 0 20">{BOX}</body>'),
    ),
    "chain of fixed bodies": ("", body(body(body(joints=""), joints="") + INERTIAL)),
    "branches": ("", body(INERTIAL + body() + body(joints=SLIDE))),
    "chain": ("", body(INERTIAL + body(BOX + body(BOX + body())))),
    # joints
    "hinge": ("", body(joints="<joint/>")),
    "hinge off the origin": ("", body(joints='<joint pos=".3 -.2 .1" axis="0 1 0"/>')),
    "axis of any length": ("", body(joints='<joint axis="3 -40 12"/>')),
    "slide": ("", body(joints='<joint type="slide" axis="1 2 0"/>')),
    "slide off the origin": ("", body(joints='<joint type="slide" axis="1 2 0" pos="1 2 3"/>')),
    "reference of a hinge": ("", body(joints='<joint ref="35" pos=".2 .1 0" axis="1 1 1"/>')),
    "reference of a slide": ("", body(joints='<joint type="slide" ref=".7" axis="1 1 1"/>')),
    "rest of a spring": ("", body(joints='<joint ref="20" springref="50" stiffness="2"/>')),
    "two hinges": ("", body(joints='<joint axis="1 0 0"/><joint axis="0 1 0" pos=".1 0 .2"/>')),
    "three hinges": (
        "",
        body(joints='<joint axis="1 0 0" ref="10"/><joint axis="0 1 0"/><joint pos="0 0 .4"/>'),
    ),
    "hinge, then slide": ("", body(joints=HINGE + SLIDE)),
    "slide, then hinge": ("", body(joints=SLIDE + HINGE)),
    "slide, hinge, slide, hinge": (
        "",
        body(joints=f'{SLIDE}{HINGE}<joint type="slide" ref=".2"/><joint axis="0 1 0" ref="40"/>'),
    ),
    "three slides": (
        "",
        body(joints=f'{SLIDE}<joint type="slide" axis="1 1 0"/><joint type="slide"/>'),
    ),
    "ball": ("", body(joints='<joint type="ball"/>')),
    "ball off the origin": (
        "",
        f'<body pos=".1 .2 .3" euler="20 30 40"><joint type="ball" pos=".3 -.2 .1"/>{BOX}'
        f"{body()}</body>",
    ),
    "chain of balls": (
        "",
        body(joints='<joint type="ball"/>', content=BOX + body(joints='<joint type="ball"/>')),
    ),
    "hinge, then ball": ("", body(joints=f'{HINGE}<joint type="ball" pos="0 .1 0"/>')),
    "slides, then ball": (
        "",
        body(joints=f'{SLIDE}<joint type="slide" axis="1 0 0" ref=".2"/><joint type="ball"/>'),
    ),
    "armature of a ball and its actuator": (
        '<actuator><motor joint="neckN" armature=".1" gear="2 0 1"/></actuator>',
        body(joints='<joint name="neckN" type="ball" armature=".3" pos="0 .1 0"/>'),
    ),
    "limits": ("", body(joints='<joint range="-30 40"/><joint axis="0 1 0" range="10 20"/>')),
    "armature": ("", body(joints='<joint armature=".4"/>')),
    "armature of a slide": ("", body(joints='<joint type="slide" armature="3"/>')),
    "armature of an actuator": (
        '<actuator><motor joint="elbowN" armature=".02" gear="7"/></actuator>',
        body(joints='<joint name="elbowN"/>'),
    ),
    "armature of two actuators and the joint": (
        '<actuator><motor joint="elbowN" armature=".02" gear="-3"/>'
        '<position jointinparent="elbowN" armature=".1" gear="2"/></actuator>',
        body(joints='<joint name="elbowN" armature=".05"/>'),
    ),
    "joint by default": (
        '<default><default class="jointN"><joint type="slide" axis="0 1 1" pos=".1 0 0" '
        'ref=".3" armature=".2"/></default></default>',
        body(joints='<joint class="jointN"/>'),
    ),
    "springs, dampers, friction": (
        "",
        body(joints='<joint stiffness="3 1" damping="2 1 1" frictionloss=".1" springref="10"/>'),
    ),
    # inertias
    "inertial": ("", body(INERTIAL)),
    "inertial, rotated": (
        "",
        body('<inertial pos=".1 0 0" quat="1 2 3 4" mass="2" diaginertia=".03 .02 .04"/>'),
    ),
    "inertial by Euler angles": (
        "",
        body('<inertial pos=".1 0 0" euler="10 20 30" mass="2" diaginertia=".03 .02 .04"/>'),
    ),
    "inertial by an axis": (
        "",
        body('<inertial pos="0 0 0" axisangle="1 2 3 50" mass="2" diaginertia=".03 .02 .04"/>'),
    ),
    "full inertia": (
        "",
        body('<inertial pos=".1 .2 0" mass="2" fullinertia=".05 .06 .07 .01 -.01 .004"/>'),
    ),
    "inertial beside shapes": ("", body(INERTIAL + '<geom size="2" mass="70"/>')),
    "inertial on the body's frame": (
        "",
        body('<inertial pos="0 0 0" mass="2" diaginertia=".03 .02 .04"/>'),
    ),
    "inertial hardly off the body's frame": (
        "",
        body('<inertial pos="1e-7 0 0" quat="1 1e-7 0 0" mass="2" diaginertia=".03 .02 .04"/>'),
    ),
    "inertial hardly rotated": (
        "",
        body('<inertial pos=".1 0 0" quat="1 1e-7 0 0" mass="2" diaginertia=".03 .02 .04"/>'),
    ),
    "flat": ("", body('<inertial pos=".1 0 0" mass="2" diaginertia=".01 .02 .03"/>')),
    "sphere": ("", geom('size=".2" pos=".3 0 0"')),
    "capsule": ("", geom('type="capsule" size=".1 .4" euler="20 0 10"')),
    "capsule from end to end": ("", geom('type="capsule" size=".1" fromto="0 0 0 .3 .4 .5"')),
    "cylinder": ("", geom('type="cylinder" size=".1 .4" quat="1 1 0 0"')),
    "cylinder from end to end": ("", geom('type="cylinder" size=".1" fromto=".1 0 0 .3 .4 .5"')),
    "box": ("", geom('type="box" size=".1 .2 .3" zaxis="1 1 0"')),
    "box from end to end": ("", geom('type="box" size=".1 .2" fromto=".1 0 0 .3 .4 .5"')),
    "ellipsoid": ("", geom('type="ellipsoid" size=".1 .2 .3" axisangle="0 1 1 33"')),
    "ellipsoid from end to end": ("", geom('type="ellipsoid" size=".1" fromto=".1 0 0 .3 .4 .5"')),
    "shell": ("", geom('type="capsule" size=".1 .4" shellinertia="true"')),
    "mass of a shape": ("", geom('size=".2" mass="3" pos="0 .2 0"')),
    "density of a shape": ("", geom('type="box" size=".1 .2 .3" density="77"')),
    "several shapes": (
        "",
        body(f'{BOX}<geom size=".1"/><geom type="capsule" size=".05" fromto="0 0 0 1 0 0"/>'),
    ),
    "shape without contact": ("", geom('size=".2" contype="0" conaffinity="0" pos=".1 0 0"')),
    "shape without mass": ("", body(BOX + '<geom size=".2" mass="0"/>')),
    "shape by default": (
        '<default><default class="shapeN"><geom type="ellipsoid" size=".1 .2 .3" pos=".1 0 0" '
        'euler="0 40 0" mass="2"/></default></default>',
        geom('class="shapeN"'),
    ),
    "shape in a frame": ("", body(f'<frame pos=".1 .2 0" euler="0 0 40">{BOX}</frame>')),
    "default in a default": (
        '<default><default class="outerN"><geom type="box" size=".1 .2 .3"/>'
        '<default class="innerN"><geom density="50"/></default></default></default>',
        geom('class="innerN"'),
    ),
    "mesh": mesh(),
    "mesh, convex": mesh('inertia="convex"', vertices=OPEN),
    "mesh, exact": mesh('inertia="exact"'),
    "mesh, legacy": mesh('inertia="legacy"'),
    "mesh, shell": mesh('inertia="shell"'),
    "mesh, scaled": mesh('scale="1 2 -.5"'),
    "mesh, moved": mesh('refpos=".1 .2 .3" refquat="1 0 1 0"'),
    "mesh of some mass": mesh("", 'type="mesh" mass="4"'),
    "box around a mesh": mesh("", 'type="box"'),
    "capsule around a mesh, larger": mesh("", 'type="capsule" fitscale="1.4"'),
    "built-in mesh": (
        '<asset><mesh name="meshN" builtin="wedge" params="4 4 30 30 0"/></asset>',
        geom('type="mesh" mesh="meshN" density="3"'),
    ),
    "mesh without mass": (
        '<asset><mesh name="meshN" file="no_such_file.stl"/></asset>',
        body(INERTIAL + '<geom type="mesh" mesh="meshN"/>'),
    ),
}  # fmt: skip

# Settings that apply to the whole file.
HEADS: dict[str, str] = {
    "nothing": "",
    "radians": '<compiler angle="radian"/>',
    "Euler sequence, turning axes": '<compiler eulerseq="zyx"/>',
    "Euler sequence, fixed axes": '<compiler eulerseq="XYZ"/>',
    "Euler sequence, mixed": '<compiler eulerseq="yXz"/>',
    "groups with mass": '<compiler inertiagrouprange="0 1"/>',
    "inertia from shapes always": '<compiler inertiafromgeom="true"/>',
    "total mass": '<compiler settotalmass="7"/>',
    "least mass": '<compiler boundmass="1.5"/>',
    "least moment": '<compiler boundinertia=".2"/>',
    "moments balanced": '<compiler balanceinertia="true"/>',
    "free joints aligned": '<compiler alignfree="true"/>',
    "fixed bodies fused": '<compiler fusestatic="true"/>',
    "visual geoms discarded": '<compiler discardvisual="true"/>',
    "boxes around meshes": '<compiler fitaabb="true"/>',
    "compiler twice": '<compiler angle="radian"/><compiler eulerseq="zxz"/>',
    "gravity": '<option gravity="1 -2 3"/>',
    "no gravity": '<option><flag gravity="disable"/></option>',
    "options twice": '<option timestep="1"/><option gravity="0 3 0"/>',
    "shape by default": '<default><geom density="400"/></default>',
    "joint by default": '<default><joint axis="1 1 0"/></default>',
}

# Joints of the carrying body.
ROOTS: dict[str, str] = {
    "fixed": "",
    "free": "<freejoint/>",
    "free, as a joint": '<joint type="free" pos="1 2 3" ref="5"/>',
    "ball": '<joint type="ball" pos=".1 .2 .3"/>',
    "hinge": '<joint axis="1 2 3" pos=".1 0 .2" ref="20"/>',
    "hinge with a rotor": '<joint axis="1 2 3" armature=".7"/>',
    "slide": '<joint type="slide" axis="1 2 3" ref=".4"/>',
    "slide and hinge": f"{SLIDE}{HINGE}",
    "ball and slide": f'<joint type="ball" pos="0 0 .1"/>{SLIDE}',
    "plane": '<joint type="slide" axis="1 0 0"/><joint type="slide"/><joint axis="0 1 0"/>',
    "three slides and a ball": "".join(
        f'<joint type="slide" axis="{axis}" ref=".3"/>' for axis in ("1 0 0", "1 1 0", "0 0 1")
    )
    + '<joint type="ball" pos=".1 .2 0"/>',
    "three slides and three hinges": "".join(
        f'<joint type="{kind}" axis="{axis}"/>'
        for kind in ("slide", "hinge")
        for axis in ("1 0 0", "0 1 0", "0 0 1")
    ),
}


def robot(
    heads: str, root: str, arms: list[str], attributes: str = 'pos="1 2 3" euler="5 6 7"'
) -> str:
    """Return a file with one robot: a carrying body with arms."""
    numbered = "".join(arm.replace("N", str(k)) for k, arm in enumerate(arms))
    carrier = f'<body name="base" {attributes}>{ROOTS[root]}{BOX}{numbered}</body>'
    return f"<mujoco>{heads}<worldbody>{carrier}</worldbody></mujoco>"


def of_construct(name: str, root: str = "free") -> str:
    """Return a file with one construct."""
    head, arm = CONSTRUCTS[name]
    return robot(head.replace("N", "0"), root, [arm])


def mixed(rng: np.random.Generator) -> str:
    """Return a file with random constructs, settings and root."""
    settings = rng.choice(list(HEADS), 2, replace=False)
    candidates = list(CONSTRUCTS)
    if "inertia from shapes always" in settings:
        candidates.remove(
            "mesh without mass"
        )  # its mesh file would be needed then, and does not exist
    names = rng.choice(candidates, rng.integers(2, 7), replace=False)
    heads = [CONSTRUCTS[name][0].replace("N", str(k)) for k, name in enumerate(names)]
    root = str(rng.choice(list(ROOTS)))
    return robot(
        "".join([HEADS[s] for s in settings] + heads), root, [CONSTRUCTS[n][1] for n in names]
    )


FAR = '<site name="far" pos="0 0 2"/>'
# Forces and constraints of a file that pinred ignores and reports. For each kind: a head, content
# of the body "arm", content of the world, and the names that are reported.
ACTING = {
    "actuators": (
        '<actuator><motor name="m" joint="arm"/><general site="tip"/><motor tendon="line"/>'
        '<adhesion body="base" ctrlrange="0 1"/><motor name="not" joint="drift"/></actuator>'
        '<tendon><fixed name="line"><joint joint="arm" coef="1"/></fixed></tendon>',
        '<site name="tip"/>', "", ("actuator 1 (site)", "actuator 2 (tendon)", "actuator 3 (body)"),
    ),
    "plastic springs": (
        '<default><joint stiffness="2" springyield=".1"/></default>', "", "", ("arm",),
    ),
    "joint limits": ('<default><joint range="-1 1"/></default>', "", "", ("arm",)),
    "contact": (
        '<contact><pair geom1="pin" geom2="stone"/></contact>',
        '<geom name="ball" size=".1" contype="1" mass="0"/><geom name="pin" size=".1" mass="0"/>',
        '<geom name="stone" size=".1"/>', ("ball", "pin"),
    ),
    "fluid": ('<option density="1.2"/>', "", "", ("density 1.2, viscosity 0",)),
    "tendons": (
        '<tendon><spatial name="rope" stiffness="3"><site site="tip"/><site site="top"/></spatial>'
        '<spatial name="strut" stiffness="3"><site site="tip"/><site site="far"/></spatial>'
        '<spatial name="slack"><site site="tip"/><site site="top"/></spatial>'
        '<fixed name="stop" range="-1 1"><joint joint="arm" coef="1"/></fixed></tendon>',
        f'<site name="tip"/>{FAR}', '<site name="top"/>', ("rope", "stop"),
    ),
    "equality constraints": (
        '<equality><weld name="held" body1="arm" body2="hand"/>'
        '<connect name="apart" body1="side" anchor="0 0 0"/></equality>',
        "", '<body name="hand" mocap="true"/>', ("held",),
    ),
    "compensated gravity": (
        "", f'<body name="light" gravcomp="1">{INERTIAL}</body>', "", ("light",),
    ),
}  # fmt: skip
# The MuJoCo flags that disable these kinds.
SWITCHES = {
    "actuators": "actuation", "plastic springs": "spring",
    "joint limits": "limit", "contact": "contact",
    "equality constraints": "equality", "compensated gravity": "gravity",
}  # fmt: skip
