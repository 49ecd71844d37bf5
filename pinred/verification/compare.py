"""compare(): the judge.  Pinocchio's ABA on the full state against a reduced trajectory.

The full simulation (full_state.py) shares no dynamics with the reduced one.  It runs at a
tolerance 100 times tighter, by two methods of order 8 and 5, whose difference tells how
accurate the judge is.

What passes: an integrator of tolerance tol makes a local error of about tol at each of
some hundred steps, and the motion itself stretches what has been made by a factor that
depends on the robot.  That factor, the growth, is measured: the full simulation is
repeated from a state kicked by 1e-6.  So errors may reach 100 · growth · tol, in units of
1 rad (or of the largest angle), and of the robot's size (or of its largest distance from
the origin).  Where the growth makes this bound exceed 0.1, or blows the kick up to 0.1,
the endpoint says nothing, and the comparison fails rather than pass by default.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from ..common.arrays import Array, freeze
from ..common.errors import InputError
from ..common.progress import Progress, shown
from ..simulation.balances import energy_balance, momentum_balance
from ..simulation.state import State
from ..simulation.trajectory import Trajectory
from .full_state import FINEST, KICK, Audit, FullMotion, FullState

TIGHTER = 100.0  # the reference's tolerance is this much below the one asked for
ALLOWANCE = 100.0  # steps whose local errors add up
SAMPLES = 101  # times at which a motion is judged, besides those it reports
CONSISTENT = 1e-9  # relative; pose, twist, momenta and energy are functions of q and v
JUDGEABLE = 0.1  # rad; a bound above it says nothing
_RESOLVED = 1e-13  # relative; what the reference and its energies can tell from round-off


@dataclass(frozen=True)
class Report:
    """The distance of a reduced trajectory from the full simulation, and its bounds.

    t: (T,) the times judged [s].  shape_errors: (T,) largest |Δx| [rad | m].
    rotation_errors [rad] and position_errors [m]: (T,) norms of the parts of log(g⁻¹ĝ).
    The singular names are the largest over time.  energy_drift: largest |E − E0| over the
    kinetic energy.  momentum_drift: the same of the conserved momentum, angular about the
    centre of mass, over √(2mT) (times the radius of gyration).  field_error: largest
    difference of pose, twist, momenta and energy from what Pinocchio makes of q and v.
    reference_error: how far two references, of order 8 and 5, are apart [relative to the
    motion's size].  growth: factor by which a small perturbation of the initial state
    grew.  *_bound: what passes.  wall_reduced, wall_full: seconds of integration at the
    same tolerance.  left_out: a sentence on springs, dampers and friction in the robot's file
    that neither side has, or nothing.
    """

    robot: str
    engine: str
    group: str
    joints: int
    duration: float
    rtol: float
    atol: float
    t: Array
    shape_errors: Array
    rotation_errors: Array
    position_errors: Array
    energy_drift: float
    momentum_drift: float
    field_error: float
    reference_error: float
    growth: float
    shape_bound: float
    rotation_bound: float
    position_bound: float
    drift_bound: float
    growth_bound: float
    wall_reduced: float
    wall_full: float
    left_out: str = ""

    def __post_init__(self) -> None:
        freeze(self)

    @property
    def shape_error(self) -> float:
        """Largest shape error over time [rad | m]."""
        return float(self.shape_errors.max())

    @property
    def rotation_error(self) -> float:
        """Largest rotation error of the base over time [rad]."""
        return float(self.rotation_errors.max())

    @property
    def position_error(self) -> float:
        """Largest position error of the base over time [m]."""
        return float(self.position_errors.max())

    @property
    def checks(self) -> dict[str, tuple[float, float]]:
        """Judged numbers: name to (value, largest value that passes)."""
        return {
            "shape error [rad | m]": (self.shape_error, self.shape_bound),
            "rotation error [rad]": (self.rotation_error, self.rotation_bound),
            "position error [m]": (self.position_error, self.position_bound),
            "reference error [relative]": (self.reference_error, self.rotation_bound),
            "energy drift [relative]": (self.energy_drift, self.drift_bound),
            "momentum drift [relative]": (self.momentum_drift, self.drift_bound),
            "fields against q, v": (self.field_error, CONSISTENT),
            "growth of perturbations": (self.growth, self.growth_bound),
        }

    @property
    def passed(self) -> bool:
        """Whether every value is within its bound; one that is not a number never is."""
        return all(value <= bound for value, bound in self.checks.values())

    def __str__(self) -> str:
        head = (
            f"{self.robot}: {self.group} × {self.joints} joints, {self.duration:g} s, "
            f"rtol {self.rtol:g}, atol {self.atol:g}\n"
            f"reduced equations against Pinocchio's ABA on the full state\n"
            + (f"{self.left_out}\n" if self.left_out else "")
        )
        rows = [
            f"  {name:<27} {value:10.2e}   allowed {bound:8.1e}   "
            f"{'ok' if value <= bound else 'FAILED'}"
            for name, (value, bound) in self.checks.items()
        ]
        rows.append(
            f"  {'wall time [s]':<27} {self.wall_reduced:10.5f} reduced ({self.engine}), "
            f"{self.wall_full:.3f} full (ABA called from Python)"
        )
        return head + "\n".join(rows) + f"\n  verdict: {'PASSED' if self.passed else 'FAILED'}"

    def _repr_html_(self) -> str:
        from ..common.html import card, line, table, verdict

        about = (
            f"{self.group} × {self.joints} joints, {self.duration:g} s, rtol {self.rtol:g}, "
            f"atol {self.atol:g}; reduced equations against Pinocchio's ABA on the full state"
        )
        rows = [
            (name, f"{value:.2e}", f"{bound:.1e}", verdict(value <= bound))
            for name, (value, bound) in self.checks.items()
        ]
        return card(
            self.robot,
            about,
            *([line(self.left_out)] if self.left_out else []),
            table("", ["", "value", "allowed", ""], rows),
            line(
                f"wall time: {self.wall_reduced:.5f} s reduced ({self.engine}), "
                f"{self.wall_full:.3f} s full (ABA called from Python)"
            ),
            line("verdict:", verdict(self.passed, "PASSED")),
        )


def compare(traj: Trajectory, *, progress: Progress | bool | None = None) -> Report:
    """Judge a trajectory against the full simulation of the same scene.

    progress: True for a progress bar; or a function that is called with the part of the work
        that is done, 0 to 1.
    Raises IntegrationError if the full simulation cannot be followed.
    """
    if not isinstance(traj, Trajectory):
        raise InputError(
            f"compare takes a Trajectory, got {type(traj).__name__}; simulate makes one"
        )
    with shown(progress, "full") as done:
        return _judged(traj, done or (lambda _: None))


def _judged(traj: Trajectory, done: Progress) -> Report:
    scene, start, rtol, atol = traj.scene, traj.scene.start, traj.scene.rtol, traj.scene.atol
    # Whatever times the scene reports, all of the motion is judged.
    times = np.union1d(traj.t, np.linspace(0.0, scene.end, SAMPLES))
    states = traj(times)
    full = FullState(scene)
    y0 = full.state(start.pose, start.x, start.xi, start.xdot)
    began = time.perf_counter()
    full.run(y0, np.array([scene.end]), rtol, atol)
    wall_full = time.perf_counter() - began
    done(0.1)
    tight = max(rtol / TIGHTER, FINEST[0]), atol / TIGHTER
    truth = full.run(y0, times, *tight)
    done(0.3)
    growth = full.growth(y0, truth, times, *tight)
    done(0.5)
    second = full.run(y0, times, *tight, method="dopri5")
    done(0.9)
    error = full.distance(truth, FullMotion(x=states.x, q=traj.system.sorted_q(states.q)))
    audit = audited(traj, states)
    size = full.size(truth)
    done(1.0)
    resolved = max(rtol, _RESOLVED) + atol
    allowed = ALLOWANCE * growth * resolved
    return Report(
        robot=traj.system.name,
        engine=traj.run.engine,
        group=traj.system.group.name,
        joints=traj.system.m,
        duration=scene.end,
        rtol=rtol,
        atol=atol,
        t=times,
        shape_errors=error.shape,
        rotation_errors=error.rotation,
        position_errors=error.position,
        energy_drift=audit.energy,
        momentum_drift=audit.momentum,
        field_error=audit.fields,
        reference_error=full.distance(truth, second).worst(size),
        growth=growth,
        shape_bound=allowed * size.shape,
        rotation_bound=allowed,
        position_bound=allowed * size.position,
        drift_bound=ALLOWANCE * resolved,
        growth_bound=JUDGEABLE / max(KICK, ALLOWANCE * resolved),
        wall_reduced=traj.run.wall,
        wall_full=wall_full,
        left_out=scene.left_out,
    )


def audited(traj: Trajectory, states: State) -> Audit:
    """Return what Pinocchio says of states of a trajectory, work and impulse taken off."""
    work = energy_balance(traj.plan, traj.motion, states).work.sum(axis=1)
    impulse = None
    if traj.plan.acting.momentum_changes:
        impulse = momentum_balance(traj.plan, traj.motion, states).impulse
    return FullState(traj.scene).audit(states, work, impulse)
