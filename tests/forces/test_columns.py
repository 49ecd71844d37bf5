"""Columns of the arguments and values of forces, with follower joints."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from coupled_trees import make_case
from trees import random_model

import pinred
from pinred.forces.columns import Column, symbols_of, torque_column
from pinred.forces.force import Terms
from pinred.forces.force_numbers import Prescribed
from pinred.lie import GROUPS


@pytest.mark.parametrize("group", GROUPS)
def test_momenta_share_symbols_only_about_a_fixed_axis(group: str) -> None:
    """There the spatial momentum equals the body momentum."""
    seen = symbols_of(pinred.load(random_model(group, 1, 0)), None)[0].seen
    assert (str(seen.J) == str(seen.mu)) is (group == "SO2")


def test_columns_have_entries_for_followers() -> None:
    """By name and by indices from m on, outside of the column itself."""
    a, f = ca.SX.sym("a", 2), ca.SX.sym("f")
    column = Column(a, ("one", "two", "third"), "x", [f])
    assert column.shape == (2, 1)
    for key, entry in (("one", a[0]), ("two", a[1]), (1, a[1]), ("third", f), (2, f), (-1, a[1])):
        assert ca.is_equal(column[key], entry), key


def test_torques_on_followers_act_on_leaders_by_ratio() -> None:
    """Virtual work, added to torques on the leader itself."""
    system = make_case("SE3", 6, 0).system
    assert system.coupled is not None
    torque = {k: float(k + 1) for k in range(system.m + len(system.followers))}
    column = np.array(ca.DM(torque_column(Terms(torque=torque), system))).ravel()
    for k in range(system.m):
        rate = np.eye(system.m)[k]
        rates = system.joint_rates(np.append(np.zeros(system.r), rate))[system.r :]
        names = [system.model.names[i] for i in range(2, system.model.njoints)]
        named = dict(zip(names, rates.tolist(), strict=True))
        order = [*system.shape_names, *system.followers]
        work = sum(torque[j] * named[name] for j, name in enumerate(order))
        assert column[k] == pytest.approx(work)


def test_prescribed_motion_is_read_only() -> None:
    """Its arrays cannot be changed."""
    prescribed = Prescribed(x=np.zeros(1), xdot=np.zeros(1), xddot=np.zeros(1))
    assert not any(values.flags.writeable for values in vars(prescribed).values())
