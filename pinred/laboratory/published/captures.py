"""Bodies that stick together, with numbers of a textbook."""

from __future__ import annotations

from .public_names import Model, Scene, capture, load
from .row import Numbers, numbers, row

POINT = 1e-12  # moment of inertia of the disc, which the textbook takes as a point [kg m²]


@row(
    "disc-and-stick",
    "a disc hits the end of a stick and sticks: speed of both [m/s], rotation [rad/s], loss [J]",
    "R. A. Serway, J. W. Jewett, Physics for Scientists and Engineers (2008), example 11.9; "
    "C. E. Mungan, Perfectly inelastic collision between a disk and a stick (2012)",
    relative=1e-11,
)
def disc_and_stick() -> Numbers:
    """Compare a disc of 2 kg at 3 m/s, and a stick of 1 kg and 4 m at rest, with the book."""
    still = (0.0, 0.0, 0.0)
    stick = Model("stick").body("stick", mass=1.0, inertia=1.0 * 4.0**2 / 12.0)
    stick = stick.fixed("end", parent="stick", at=[0.0, 2.0, 0.0])
    disc = Model("disc").body("disc", mass=2.0, inertia=POINT)
    both = capture(
        Scene(system=load(stick, group="SE2", gravity=still), xi0=[0.0, 0.0, 0.0]),
        Scene(
            system=load(disc, group="SE2", gravity=still),
            pose0=[0.0, 2.0, 0.0], xi0=[3.0, 0.0, 0.0],
        ),
        at="end", onto="disc",
    )  # fmt: skip
    rotation = both.instant.xi[2]
    centre = 2.0 * 2.0 / (2.0 + 1.0)  # of both, from the centre of the stick [m]
    speed = both.instant.xi[0] - centre * rotation
    return numbers([2.0, -1.0, 1.0], [speed, rotation, both.energy_lost])


ROWS = (disc_and_stick,)
