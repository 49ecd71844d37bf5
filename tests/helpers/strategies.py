"""Hypothesis strategies for random systems and states, from seeds that hypothesis prints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from trees import random_model

import pinred
from pinred.common.arrays import Array
from pinred.lie import GROUPS

groups = st.sampled_from(sorted(GROUPS))
seeds = st.integers(0, 2**32 - 1)


def examples(quick: int, many: int) -> settings:
    """Return the settings of a test: its number of examples in the default run, and by hand."""
    is_quick = settings.default is settings.get_profile("repeatable")
    return settings(max_examples=quick if is_quick else many)


@dataclass(frozen=True)
class Case:
    """A random system and a random state of it."""

    system: pinred.System
    pose: Array
    x: Array
    xdot: Array
    xi: Array
    rng: np.random.Generator

    @property
    def q(self) -> Array:
        """The configuration in Pinocchio's coordinates, (nq,)."""
        return self.system.q(self.pose, self.x)

    @property
    def v(self) -> Array:
        """The velocity in Pinocchio's coordinates, (nv,)."""
        return self.system.v(self.xi, self.xdot)


def make_case(group: str, joints: int, seed: int) -> Case:
    """Return the case of a seed."""
    system = pinred.load(random_model(group, joints, seed))
    rng = np.random.default_rng(seed)
    return Case(
        system=system,
        pose=system.group.exp(rng.uniform(-1.5, 1.5, system.r)),
        x=rng.uniform(-2.0, 2.0, system.m),
        xdot=rng.normal(size=system.m),
        xi=rng.normal(size=system.r),
        rng=rng,
    )


def cases(least: int = 1, most: int = 8) -> st.SearchStrategy[Case]:
    """Return a strategy for random trees of `least` to `most` joints on any group."""
    return st.builds(make_case, groups, st.integers(least, most), seeds)
