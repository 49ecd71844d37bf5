"""Columns of what forces see and give, with joints that follow others."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from coupled_trees import make_case
from trees import random_model

import pinred
from pinred.forces.acting import Prescribed
from pinred.forces.columns import symbols_of, torque_column
from pinred.forces.force import Terms
from pinred.forces.named_arrays import Column
from pinred.lie import GROUPS


@pytest.mark.parametrize("group", GROUPS)
def test_momenta_that_are_the_same_numbers(group: str) -> None:
    """About one fixed axis the spatial momentum is the body's, else it has to be told apart."""
    seen = symbols_of(pinred.load(random_model(group, 1, 0)), None)[0].seen
    assert (str(seen.J) == str(seen.mu)) is (group == "SO2")


def test_followers_have_entries() -> None:
    """By name and by the numbers behind the shape's, and are no part of the column."""
    a, f = ca.SX.sym("a", 2), ca.SX.sym("f")
    column = Column(a, ("one", "two", "third"), "x", [f])
    assert column.shape == (2, 1)
    for key, entry in (("one", a[0]), ("two", a[1]), (1, a[1]), ("third", f), (2, f), (-1, a[1])):
        assert ca.is_equal(column[key], entry), key


def test_torques_on_followers_act_on_leaders() -> None:
    """By the ratio of their rates, beside those on the leader itself: virtual work."""
    system = make_case("SE3", 6, 0).system
    assert system.coupled is not None
    torque = {k: float(k + 1) for k in range(system.m + len(system.followers))}
    found = np.array(ca.DM(torque_column(Terms(torque=torque), system))).ravel()
    for k in range(system.m):
        rate = np.eye(system.m)[k]
        every = system.joint_rates(np.append(np.zeros(system.r), rate))[system.r :]
        names = [system.model.names[i] for i in range(2, system.model.njoints)]
        named = dict(zip(names, every.tolist(), strict=True))
        order = [*system.shape_names, *system.followers]
        work = sum(torque[j] * named[name] for j, name in enumerate(order))
        assert found[k] == pytest.approx(work)


def test_what_is_prescribed_is_kept() -> None:
    """Its arrays cannot be changed behind it."""
    given = Prescribed(x=np.zeros(1), xdot=np.zeros(1), xddot=np.zeros(1))
    assert not any(values.flags.writeable for values in vars(given).values())
