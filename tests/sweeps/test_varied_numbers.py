"""Every kind of number varies, with the results of a scene that states it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from twelve_gains import OTHER, assert_same_bits, scene_of, vector_parameter

import pinred
from pinred.forces import Damper, Spring

CAT = pinred.load("falling_cat")
OPTIONS: dict[str, Any] = {
    "system": CAT, "duration": 0.3, "rtol": 1e-8, "atol": 1e-10, "x0": [0.3, -0.2, 0.1],
    "xdot0": [0.5, -0.3, 0.2], "springs": {"sway": (1.0, 0.1)},
    "forces": [Damper("bend", 0.1), Spring("twist", 2.0)],
}  # fmt: skip


def vector(size: int, entry: int, value: float) -> list[float]:
    """Return zeros except one entry."""
    return [value if k == entry else 0.0 for k in range(size)]


CASES: dict[str, tuple[float, Callable[[float], dict[str, Any]]]] = {
    "x0.bend": (0.7, lambda v: {"x0": [v, -0.2, 0.1]}),
    "xdot0.sway": (0.7, lambda v: {"xdot0": [0.5, v, 0.2]}),
    "xi0.omega3": (0.2, lambda v: {"xi0": vector(6, 5, v)}),
    "pose0.y": (0.4, lambda v: {"pose0": [0, v, 0, 0, 0, 0, 1]}),
    "front.com.z": (0.1, lambda v: {"parameters": {"front.com": [0.0, 0.0, v]}}),
    "front.mass": (1.2, lambda v: {"parameters": {"front.mass": v}}),
    "springs.sway.rest": (0.4, lambda v: {"springs": {"sway": (1.0, v)}}),
    "forces[0].coefficient": (0.4, lambda v: {"forces": [Damper("bend", v), Spring("twist", 2.0)]}),
    "gravity.z": (-3.0, lambda v: {"parameters": {"gravity": [0, 0, v]}}),
}


@pytest.mark.by_hand("front.com.z")
@pytest.mark.parametrize("key", CASES)
def test_varied_number_gives_the_motion_of_its_scene(key: str) -> None:
    """A sweep over two values contains the motion of a scene with that value."""
    value, options = CASES[key]
    if key == "front.com.z":
        com = pinred.Scene(system=CAT, parameters=["front.com"]).parameters["front.com"]
        stated: dict[str, Any] = {"parameters": {"front.com": [*com[:2], value]}}
    else:
        stated = options(value)
    result = pinred.sweep(
        pinred.Scene(**OPTIONS), {key: [value, 0.9 * value]}, outputs=["pose", "x"]
    )
    judge = pinred.simulate(pinred.Scene(**OPTIONS | stated), method="DOP853")
    np.testing.assert_allclose(result["pose"][0], judge.pose[-1], rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(result["x"][0], judge.x[-1], rtol=1e-11, atol=1e-11)
    assert not np.allclose(
        np.append(result["pose"][0], result["x"][0]),
        np.append(result["pose"][1], result["x"][1]), rtol=1e-6, atol=1e-6,
    )  # fmt: skip


def test_prescribed_numbers_and_seeds_vary() -> None:
    """A prescribed number is the shape of its joint; seeds give random initial states."""
    scene = pinred.Scene(**OPTIONS | {"springs": {}, "forces": [], "prescribed": {"sway": 0.2}})
    result = pinred.sweep(scene, {"prescribed.sway": [0.1, 0.4]}, outputs=["x.sway"])
    np.testing.assert_allclose(result["x.sway"], [0.1, 0.4], rtol=1e-15)
    random = pinred.Scene(system=CAT, duration=0.3, seed=9)
    seeds = pinred.sweep(random, {"seed": [1, 9]}, outputs=["x"])
    for k, seed in enumerate((1, 9)):
        judge = pinred.simulate(CAT, duration=0.3, seed=seed)
        np.testing.assert_allclose(seeds["x"][k], judge.x[-1], rtol=0, atol=1e-7)


def test_entries_of_balls_are_rotation_vectors() -> None:
    """An entry of a ball in x0 belongs to its rotation vector."""
    system = pinred.load("falling_cat_ball")
    (ball,) = system.space.balls
    scene = pinred.Scene(system=system, duration=0.2, x0={ball.name: [0.1, 0.2, 0.3]})
    result = pinred.sweep(scene, {f"x0.{ball.name}.y": [0.2, 0.5]}, outputs=["x"])
    for k, y in enumerate((0.2, 0.5)):
        judge = pinred.simulate(system, duration=0.2, x0={ball.name: [0.1, y, 0.3]})
        np.testing.assert_allclose(result["x"][k], judge.x[-1], rtol=0, atol=1e-8)


def test_initial_state_of_another_form_varies() -> None:
    """If the scene states q0 and v0, the entries of shape and rates still vary."""
    base = pinred.simulate(CAT, seed=3, duration=0.1)
    scene = pinred.Scene(system=CAT, duration=0.1, q0=base.q[0], v0=base.v[0])
    result = pinred.sweep(scene, {"x0.bend": [base.x[0, 0], 0.5]}, outputs=["x"])
    np.testing.assert_allclose(result["x"][0], base.x[-1], rtol=0, atol=1e-9)


def test_strength_of_no_gravity_is_rejected() -> None:
    """Without gravity there is no direction; with it, the strength varies as a Scene states it."""
    with pytest.raises(pinred.InputError, match=r"has no direction to scale; vary 'gravity\.z'"):
        pinred.sweep(pinred.Scene(**OPTIONS), {"gravity.strength": [1.0, 2.0]})
    cart = pinred.load("cartpole")
    result = pinred.sweep(
        pinred.Scene(system=cart, duration=0.3), {"gravity.strength": [4.0]}, outputs=["x"]
    )
    judge = pinred.simulate(cart, duration=0.3, parameters={"gravity.strength": 4.0})
    np.testing.assert_allclose(result["x"][0], judge.x[-1], rtol=0, atol=1e-9)


def test_sweep_varies_entries_of_vectors() -> None:
    """A sweep varies an entry by its name; the other entries have their values in the scene."""
    scene = scene_of(vector_parameter(), parameters={"u": OTHER})
    result = pinred.sweep(scene, {"u[3]": [0.5, 1.5]}, outputs={"bend": "x.bend"})
    for k, value in enumerate((0.5, 1.5)):
        values = OTHER.copy()
        values[3] = value
        x = pinred.simulate(scene, parameters={"u": values}).x[-1]
        np.testing.assert_allclose(result["bend"][k], x[0], atol=1e-7)
        assert_same_bits(result.point(k).scene.parameters["u"], values)
    with pytest.raises(
        pinred.InputError, match=r"'u' is a vector. Vary some of its entries: u\[0\]"
    ):
        pinred.sweep(scene, {"u": [0.5, 1.5]}, outputs=["x"])
