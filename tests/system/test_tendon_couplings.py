"""Equality constraints of fixed tendons, against MuJoCo's residuals and a closed form."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from numpy.typing import ArrayLike

import pinred
from pinred import InputError, ModelError
from pinred.common.arrays import Array
from pinred.forces import Torque

LEG = (
    ("yaw", "0 0 1", 0.0),
    ("pitch", "0 1 0", 0.3),
    ("knee", "0 1 0", -0.2),
    ("ankle", "0 1 0", 0.0),
)


def legs(count: int) -> str:
    """Return legs of four hinges each, as those of a quadruped; some have a reference position."""
    text = ""
    for leg in range(count):
        inner = ""
        for name, axis, ref in reversed(LEG):
            place = (
                f'pos="0.2 0 0" euler="0 0 {90 * leg}"' if name == "yaw" else 'pos="0.25 0 -0.1"'
            )
            inner = (
                f'<body {place}><joint name="{name}{leg}" axis="{axis}" ref="{ref}"/>'
                f'<inertial pos="0.1 0 0" mass="1" diaginertia=".02 .03 .04"/>{inner}</body>'
            )
        text += inner
    return text


def tendon(name: str, **coefficients: float) -> str:
    """Return a fixed tendon over joints."""
    joints = "".join(f'<joint joint="{j}" coef="{c}"/>' for j, c in coefficients.items())
    return f'<fixed name="{name}">{joints}</fixed>'


def robot(bodies: str, tendons: str, equalities: str, joint: str = "<freejoint/>") -> str:
    """Return a robot with tendons and equality constraints."""
    return (
        '<mujoco><compiler angle="radian"/><option gravity="0 0 0"/><worldbody>'
        f'<body name="base">{joint}<inertial pos="0 0 0" mass="5" diaginertia="3 4 4.32"/>{bodies}'
        f"</body></worldbody><tendon>{tendons}</tendon><equality>{equalities}</equality></mujoco>"
    )


def loaded(text: str, **options: object) -> pinred.System:
    """Return the system of an MJCF text."""
    return pinred.load(mujoco.MjSpec.from_string(text), **options)  # type: ignore[arg-type]


def residuals(text: str, values: dict[str, float]) -> Array:
    """Return the residuals of the equality constraints in MuJoCo at joint values."""
    model = mujoco.MjSpec.from_string(text).compile()
    data = mujoco.MjData(model)
    for name, value in values.items():
        data.qpos[model.joint(name).qposadr] = value
    mujoco.mj_forward(model, data)
    rows = data.efc_type[: data.nefc] == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)
    return np.asarray(data.efc_pos[: data.nefc][rows])


def joint_values(system: pinred.System, x: ArrayLike) -> dict[str, float]:
    """Return the values of all joints at a shape, followers included, by name."""
    names = [str(name) for name in system.model.names[2:]]
    values = system.joint_values(np.asarray(x, dtype=float))
    return dict(zip(names, values.tolist(), strict=True))


HINGES = "".join(
    f'<body pos="{place} 0 0"><joint name="hinge{k}" axis="0 0 1"/>'
    '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'
    for k, place in ((1, 0.2), (2, -0.2))
)
PAIR = robot(
    HINGES, tendon("line", hinge1=0.5, hinge2=-0.5), '<tendon tendon1="line"/>'
)  # two hinges of inertia 1 on a base of inertia 4.4


def test_two_hinges_coupled_by_tendon_move_together() -> None:
    """Under 1 N·m on one hinge, x = t²/(2 M) with M = 2·4.4/6.4: 4/11 after 1 s for both."""
    system = loaded(PAIR)
    assert system.m == 1
    (coupling,) = system.couplings
    assert (coupling.follower, dict(coupling.ratios)) == ("hinge2", {"hinge1": 1.0})
    forces = [Torque({"hinge1": 1.0})]
    traj = pinred.simulate(system, x0=[0.0], momentum=0, duration=1.0, forces=forces)
    values = joint_values(system, traj.x[-1])
    assert values["hinge1"] == pytest.approx(4.0 / 11.0, abs=1e-12)
    assert values["hinge2"] == values["hinge1"]
    assert pinred.compare(traj).passed


def quadruped() -> str:
    """Return four legs with tendons as those of dm_control's quadruped."""
    tendons = "".join(
        tendon(f"t{k}", **{f"{name}{k}": 0.333 for name in ("pitch", "knee", "ankle")})
        for k in range(4)
    )
    return robot(legs(4), tendons, "".join(f'<tendon tendon1="t{k}"/>' for k in range(4)))


def test_quadruped_with_tendons_has_twelve_coordinates() -> None:
    """One joint of each leg follows two others; MuJoCo's residuals vanish."""
    text = quadruped()
    system = loaded(text)
    assert system.m == 12
    assert system.followers == tuple(f"ankle{k}" for k in range(4))
    assert not system.left_out
    rng = np.random.default_rng(0)
    for _ in range(3):
        values = joint_values(system, rng.uniform(-1.0, 1.0, 12))
        assert np.abs(residuals(text, values)).max() < 1e-15


@pytest.mark.by_hand
@pytest.mark.parametrize("prescribed", [{}, {"pitch0": "0.3*sin(2*t)"}])
def test_quadruped_with_tendons_agrees_with_aba(prescribed: dict[str, str]) -> None:
    """In both engines, also if one of two leaders is prescribed."""
    system = loaded(quadruped())
    for engine in ("compiled", "pinocchio"):
        traj = pinred.simulate(
            system,
            seed=1,
            duration=0.3,
            prescribed=prescribed,
            engine=engine,
        )
        report = pinred.compare(traj)
        assert report.passed, str(report)


# Laws of tendons a (pitch + 2 knee) and b (3 ankle − yaw), and followers.
LAWS = {
    "held length": ('<tendon tendon1="a" polycoef=".2 0 0 0 0"/>', ["knee0"]),
    "two tendons": ('<tendon tendon1="a" tendon2="b" polycoef=".1 -2 0 0 0"/>', ["ankle0"]),
    "same tendons twice": (2 * '<tendon tendon1="b" tendon2="a"/>', ["ankle0"]),
    "both": ('<tendon tendon1="a" polycoef=".2"/><tendon tendon1="b" tendon2="a"/>',
             ["knee0", "ankle0"]),
    "with a joint constraint": (
        '<joint joint1="ankle0" joint2="knee0" polycoef=".1 2 0 0 0"/>'
        '<tendon tendon1="a" tendon2="b" polycoef=".3 1 0 0 0"/>', ["ankle0", "knee0"],
    ),
    "outside the robot": ('<tendon tendon1="other"/>', []),
    "inactive": ('<tendon tendon1="a" active="false"/>', []),
}  # fmt: skip
TENDONS = tendon("a", pitch0=1.0, knee0=2.0) + tendon("b", ankle0=3.0, yaw0=-1.0)
OTHER = '<body><joint name="far"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>'


def leg_with(equalities: str) -> str:
    """Return a robot with one leg, tendons a and b, and another robot with a tendon."""
    text = robot(legs(1), TENDONS + tendon("other", far=1.0), equalities)
    return text.replace("</worldbody>", OTHER + "</worldbody>")


@pytest.mark.parametrize("case", LAWS)
def test_linear_laws_of_tendons_have_no_residual(case: str) -> None:
    """Constants, two tendons, reference positions, redundant rows and chains."""
    equalities, followers = LAWS[case]
    text = leg_with(equalities)
    with pytest.warns(pinred.LeftOutWarning, match="other bodies"):
        system = loaded(text, root="base")
    assert list(system.followers) == followers
    rng = np.random.default_rng(0)
    for _ in range(3):
        found = residuals(text, joint_values(system, rng.uniform(-1.0, 1.0, system.m)))
        assert len(found) == equalities.count("<tendon") + equalities.count("<joint") - (
            case == "inactive"
        )
        assert np.abs(found).max(initial=0.0) < 1e-14


SPATIAL = '<spatial name="c"><site site="s"/><site site="e"/></spatial>'
REFUSED = {
    "spatial": ('<tendon tendon1="c"/>', "tendon 'c' is spatial"),
    "not in proportion": (
        '<tendon tendon1="a" tendon2="b" polycoef="0 1 .1 0 0"/>', "not in proportion",
    ),
    "contradiction": (
        '<tendon tendon1="a"/><tendon tendon1="a" polycoef=".1"/>', "contradicts .* by -0.1",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_other_constraints_of_tendons_are_refused(case: str) -> None:
    """They change the motion, so that they are not left out."""
    equalities, words = REFUSED[case]
    legged = legs(1).replace("<inertial", '<site name="s"/><inertial', 1)
    bodies = legged + '<site name="e" pos="1 0 0"/>'
    text = robot(bodies, TENDONS + tendon("one", knee0=1.0) + SPATIAL, equalities)
    with pytest.raises(ModelError, match=words):
        loaded(text)
    lock = {"yaw0": 0.0, "pitch0": 0.0, "knee0": 0.1, "ankle0": 0.0}
    if case in ("spatial", "not in proportion"):
        assert loaded(text, lock=lock).m == 0


HELD = {
    "by a tendon of one joint": '<tendon tendon1="one" polycoef=".3"/>',
    "by a tendon and a joint": (
        '<tendon tendon1="a"/><joint joint1="knee0" joint2="pitch0" polycoef="0 2 0 0 0"/>'
    ),
}


@pytest.mark.parametrize("case", HELD)
def test_joints_that_tendons_hold_are_locked(case: str) -> None:
    """They are locked where the residuals of MuJoCo are zero."""
    text = robot(legs(1), TENDONS + tendon("one", knee0=1.0), HELD[case])
    system = loaded(text)
    locked = system.contents.locked
    assert locked is not None
    values = joint_values(system, np.full(system.m, 0.2)) | dict(locked.frozen)
    assert np.abs(residuals(text, values)).max() < 1e-15


def test_locked_joints_of_tendons_become_constants() -> None:
    """With one joint locked two remain coupled; with two locked the third is locked."""
    text = robot(legs(1), tendon("t", pitch0=1.0, knee0=2.0, ankle0=4.0), '<tendon tendon1="t"/>')
    system = loaded(text, lock={"pitch0": 0.8})
    (coupling,) = system.couplings
    assert (coupling.follower, dict(coupling.ratios)) == ("ankle0", {"knee0": -0.5})
    values = joint_values(system, [0.1, 0.4])
    assert np.abs(residuals(text, values | {"pitch0": 0.8})).max() < 1e-15
    both = loaded(text, lock={"pitch0": 0.8, "knee0": 0.5})
    assert both.m == 1
    locked = both.contents.locked
    assert locked is not None
    assert np.abs(residuals(text, {"pitch0": 0.8, **locked.frozen})).max() < 1e-15
    with pytest.raises(InputError, match="'pitch0' and 'knee0'"):
        loaded(text, lock=["ankle0"])
    with pytest.raises(InputError, match=r"coupled with several joints"):
        loaded(text, lock={"pitch0": 0.8}, parameters={"pitch0.lock": 0.5})
