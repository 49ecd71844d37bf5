"""Loops to the world of robots whose base the file fixes: the base is then the ground."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import pinred
from pinred.common.arrays import Array
from pinred.common.errors import ModelError
from pinred.system.loops.kinematics import loop_values

LENGTHS = {"crank": 0.3, "coupler": 0.8, "rocker": 0.6}
BASE = ([0.2, 0.1, 0.3], [0.1, 0.2, 0.3])  # place [m] and roll, pitch, yaw [rad] of the base
TIP = np.array([-0.3, 0.5, 0.02])  # point of the rocker that the loop holds [m]


def _parents() -> dict[str, str]:
    return dict(zip(LENGTHS, ["base", *LENGTHS], strict=False))


def urdf(closing: str, base: str = '<inertial><mass value="{}"/>{}</inertial>') -> str:
    """Return bars on a base that a URDF file fixes to the world."""
    moments = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
    body = '<link name="{}"><inertial><mass value="1"/>' + moments + "</inertial></link>"
    hinge = (
        '<joint name="j_{0}" type="continuous"><parent link="{1}"/><child link="{0}"/>'
        '<origin xyz="{2} 0 0"/><axis xyz="0 0 1"/></joint>'
    )
    parents = _parents()
    hinges = [hinge.format(n, parents[n], LENGTHS.get(parents[n], 0.0)) for n in LENGTHS]
    return (
        f'<robot name="r"><link name="world"/><link name="base">{base.format(2, moments)}</link>'
        '<joint name="fix" type="fixed"><parent link="world"/><child link="base"/>'
        '<origin xyz="0.2 0.1 0.3" rpy="0.1 0.2 0.3"/></joint>'
        + "".join([*(body.format(n) for n in LENGTHS), *hinges])
        + f"\n{closing}</robot>"
    )


def sdf(closing: str) -> str:
    """Return the same bars in an SDF file."""
    parents = _parents()
    links = "".join(
        f'<link name="{n}"><pose relative_to="{parents[n]}">{LENGTHS.get(parents[n], 0.0)} 0 0 0 0 '
        "0</pose></link>"
        for n in LENGTHS
    )
    hinges = "".join(
        f'<joint name="j_{n}" type="revolute"><parent>{parents[n]}</parent><child>{n}</child>'
        "<axis><xyz>0 0 1</xyz></axis></joint>"
        for n in LENGTHS
    )
    return (
        '<sdf version="1.9"><model name="m"><link name="base"><pose>0.2 0.1 0.3 0.1 0.2 0.3</pose>'
        f'</link>{links}{hinges}<joint name="fix" type="fixed"><parent>world</parent><child>base'
        f"</child></joint>{closing}</model></sdf>"
    )


def mjcf(closing: str, mass: float = 2.0, gravity: str = "0 0 0") -> str:
    """Return the same bars in an MJCF file, with their centres of mass beside the hinges."""
    bars = ""
    for name, parent in reversed(_parents().items()):
        moment = LENGTHS[name] ** 3 / 12.0
        bars = (
            f'<body name="{name}" pos="{LENGTHS.get(parent, 0.0)} 0 0"><joint name="j_{name}" '
            f'axis="0 0 1"/><inertial mass="{LENGTHS[name]}" pos="{LENGTHS[name] / 2} 0.02 0" '
            f'diaginertia="0.05 0.05 {moment}"/>{bars}</body>'
        )
    turn = pin.Quaternion(pin.rpy.rpyToMatrix(*BASE[1])).coeffs()[[3, 0, 1, 2]]
    return (
        f'<mujoco><option gravity="{gravity}"><flag contact="disable"/></option><worldbody>'
        f'<body name="base" pos="0.2 0.1 0.3" quat="{" ".join(map(str, turn))}"><inertial '
        f'mass="{mass}" pos="0.3 0.2 0.1" diaginertia="{mass} {mass} {mass}"/>{bars}</body>'
        '<body name="table" pos="0.5 0.2 -0.4" euler="50 0 10"><body name="top" pos="0 0 0.3" '
        f'euler="0 20 0"/></body></worldbody><equality>{closing}</equality></mujoco>'
    )


def tip(x: Array) -> Array:
    """Return the place of the tip in the world, (3,) [m], in closed form."""
    angles = np.cumsum(x)
    along = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    joint = np.array([0.3, 0.8]) @ along[:2]
    c, s = along[2]
    in_base = np.array([*(joint + np.array([[c, -s], [s, c]]) @ TIP[:2]), TIP[2]])
    return np.asarray(pin.rpy.rpyToMatrix(*BASE[1]) @ in_base + BASE[0])


ANCHOR = tip(np.array([0.5, -0.9, 0.7]))  # place in the world that this point can reach [m]
ENDS = tuple(" ".join(f"{value:.17g}" for value in point) for point in (ANCHOR, TIP))

# A ball joint of `<gazebo>` and of SDF has equal frames at zero, so it holds the tip there.
FILES = {
    "loop_joint": urdf(
        '<loop_joint name="tie" type="ball"><link1 link="world" xyz="{}"/><link2 link="rocker" '
        'xyz="{}"/></loop_joint>'.format(*ENDS)
    ),
    "gazebo": urdf(
        '<gazebo><joint name="tie" type="ball"><parent>world</parent><child>rocker</child>'
        f"<pose>{ENDS[1]} 0 0 0</pose></joint></gazebo>"
    ),
    "sdf": sdf(
        '<joint name="tie" type="ball"><parent>world</parent><child>rocker</child><pose>'
        f"{ENDS[1]} 0 0 0</pose></joint>"
    ),
    "connect": mjcf(f'<connect name="tie" body1="rocker" anchor="{ENDS[1]}"/>'),
    "connect to a table": mjcf(
        f'<connect name="tie" body1="rocker" body2="top" anchor="{ENDS[1]}"/>'
    ),
}


@pytest.mark.filterwarnings("ignore:.*fixes base to the world")
@pytest.mark.parametrize("name", FILES)
def test_loop_to_the_world_closes_at_the_base_that_the_file_fixes(
    name: str, tmp_path: Path
) -> None:
    """The gap at random angles is the distance of the tip from its anchor in the world."""
    path = tmp_path / {"<r": "r.urdf", "<s": "r.sdf", "<m": "r.xml"}[FILES[name][:2]]
    path.write_text(FILES[name], "utf-8")
    system = pinred.load(path, gravity=[0, 0, 0])
    assert system.shape_names == tuple(f"j_{n}" for n in LENGTHS)
    assert [loop.name for loop in system.loops] == ["tie"]
    assert "(the file fixes 'base' to the world; here it is free)" in str(pinred.inspect(system))
    x = np.random.default_rng(3).uniform(-1.0, 1.0, 3)
    anchor = ANCHOR if name == "loop_joint" else tip(np.zeros(3))
    gap = float(np.linalg.norm(loop_values(system, x)))
    assert gap == pytest.approx(np.linalg.norm(tip(x) - anchor), rel=1e-12)


def test_weld_to_a_static_body_closes_in_the_reference_configuration() -> None:
    """The static body is two levels below the world, displaced and turned."""
    text = mjcf('<weld name="tie" body1="top" body2="rocker"/>')
    more = '<joint name="x" type="slide" axis="1 0 0"/><joint name="y" type="slide" axis="0 1 0"/>'
    text = text.replace('<joint name="j_rocker"', f'{more}<joint name="j_rocker"')
    system = pinred.load(mujoco.MjModel.from_xml_string(text))
    assert (system.m, system.shape_dim) == (5, 2)
    np.testing.assert_allclose(loop_values(system, np.zeros(5)), 0.0, atol=1e-14)


def test_heavy_base_moves_a_mechanism_as_mujocos_fixed_one() -> None:
    """MuJoCo's mass matrix and Jacobian of the same file, as exact constraints.

    The base has 1e9 times the mass of the bars, so its motion changes angles by about 1e-9 rad.
    """
    text = mjcf('<connect name="tie" body1="rocker" anchor="-0.6 0.35 0"/>', mass=1e9)
    model = mujoco.MjModel.from_xml_string(text)
    system = pinred.load(model)
    start = {"x0": {"j_crank": 0.4}, "xdot0": {"j_crank": 3.0}, "momentum": 0}
    motion = pinred.simulate(system, duration=0.3, **start)  # type: ignore[arg-type]
    assert pinred.compare(motion).passed
    data = mujoco.MjData(model)

    def jacobian(q: Array, v: Array | float = 0.0) -> Array:
        data.qpos[:], data.qvel[:] = q, v
        mujoco.mj_forward(model, data)
        return np.array(data.efc_J).reshape(data.nefc, 3)[:3]

    def rate(_: float, y: Array) -> Array:
        q, v, h = y[:3], y[3:], 1e-5
        turning = (jacobian(q + h * v) - jacobian(q - h * v)) @ v / (2.0 * h)
        J, M = jacobian(q, v), np.zeros((3, 3))
        mujoco.mj_fullM(model, data, M)
        matrix = np.block([[M, J.T], [J, np.zeros((3, 3))]])
        forces = np.concatenate([-np.array(data.qfrc_bias), -turning])
        return np.concatenate([v, np.linalg.lstsq(matrix, forces, rcond=1e-10)[0][:3]])

    begin = np.concatenate([motion.x[0], motion.xdot[0]])
    exact = solve_ivp(rate, (0.0, 0.3), begin, rtol=1e-10, atol=1e-12).y[:3, -1]
    np.testing.assert_allclose(motion.x[-1], exact, atol=2e-9)


@pytest.mark.parametrize(
    ("joints", "words"),
    [
        ("<freejoint/>", "moves by joint 'base_free'"),
        ('<joint name="swing"/>', "moves by joint 'swing'"),
    ],
)
def test_loop_to_the_world_of_a_base_with_joints_is_refused(joints: str, words: str) -> None:
    """The message names the constraint, both bodies, the joint of the base and the remedies."""
    text = mjcf(f'<connect name="tie" body1="rocker" anchor="{ENDS[1]}"/>')
    text = text.replace("<inertial", f"{joints}<inertial", 1)
    with pytest.raises(ModelError, match=words) as caught:
        pinred.load(mujoco.MjModel.from_xml_string(text))
    assert "'tie' ties 'rocker' and 'world'" in str(caught.value)
    assert "Mechanisms on the ground" in str(caught.value)


def test_massless_world_with_a_loop_is_refused(tmp_path: Path) -> None:
    """The message says that a link with mass, fixed to the world, becomes the root."""
    closing = FILES["loop_joint"].partition("\n")[2].partition("</robot>")[0]
    path = tmp_path / "r.urdf"
    path.write_text(urdf(closing, base=""), "utf-8")
    with pytest.raises(ModelError, match=r"'tie' \(line 2\).*fix a link with mass to the world"):
        pinred.load(path)
