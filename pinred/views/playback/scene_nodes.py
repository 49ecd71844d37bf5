"""The description of a motion's frames, from which films, viser's page and rerun's files are made.

All objects are nodes that move, with meshes and lines.  A writer draws nodes and knows no motion.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...common.arrays import Array, FrozenArrays
from ...lie.rotations import rotation
from ...system.urdf_shapes import Mesh
from .colours_and_view_options import LOOK, ArrowLook
from .drawn_bodies import Bodies, Colour, Solid, extents, solid_mesh
from .playback import Playback

_STILL = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])  # identity placement
_BEHIND, _ABOVE, _TOP = 1, 2, 3  # order of objects that are drawn over everything else


@dataclass(frozen=True)
class Part:
    """A mesh of a node.

    Attributes:
        mesh: The surface, in the frame of `placement`.
        flat: Whether each triangle has a constant brightness.
        placement: Position [m] and quaternion (real part last) in the node's frame, (7,).
        colour: Red, green, blue, opacity.
        lit: Whether lamps change its brightness.
    """

    mesh: Mesh
    flat: bool
    placement: Array
    colour: Colour
    lit: bool = True


@dataclass(frozen=True)
class Line:
    """A line of a node.

    Attributes:
        points: Points, (N, 3) [m].
        colour: Red, green, blue, opacity.
        grows: Whether it is drawn up to the current frame only; it has a point for each frame.
    """

    points: Array
    colour: Colour
    grows: bool = False


@dataclass(frozen=True)
class Node:
    """An object that moves as one.

    Attributes:
        path: Names from the root of the scene tree to the node.
        placements: Position [m] and quaternion (real part last) in the world frame, (F, 7).
        parts: Meshes.
        lines: Lines.
        stretch: Matrices that deform the node in its own frame, (F, 3, 3); None for a rigid node.
        opacity: Factors on the opacity of the parts, (F,), or None.
        order: 0 if nearer objects hide it; otherwise it is drawn over all nodes of lower order.
        label: Text at the origin of the node, in the colour of the first part.
    """

    path: tuple[str, str]
    placements: Array
    parts: tuple[Part, ...] = ()
    lines: tuple[Line, ...] = ()
    stretch: Array | None = None
    opacity: Array | None = None
    order: int = 0
    label: str = ""


@dataclass(frozen=True)
class Arrow(FrozenArrays):
    """The momentum arrow: start and difference to the tip, (F, 3) [m]; arrays are read-only."""

    tail: Array
    vector: Array


def scene_nodes(film: Playback, bodies: Bodies, framing: Framing, speed: float) -> list[Node]:
    """Return all objects of a film.

    Args:
        film: The motion.
        bodies: Shapes of the robot.
        framing: Framing of the film.
        speed: Seconds of the motion in one second of the film.
    Returns:
        The robot, its ghost, and the overlays: locked inertia, momentum arrow, axes of the base and
        of ball joints, centre of mass, gravity, momentum sphere and flashes of impacts.
    """
    nodes = list(_robot("robot", film, film.placements, bodies))
    if film.ghost is not None:
        placements = film.ghost.placements.copy()
        placements[..., :3] += framing.aside
        nodes += _robot("full simulation", film, placements, bodies, colour_of(*LOOK.ghost))
    return [*nodes, *_overlays(film, framing), *_flashes(film, framing, speed)]


def _overlays(film: Playback, framing: Framing) -> Iterator[Node]:
    """Yield the objects that move with joints, the centre of mass and the momentum."""
    radius, system = framing.radius, film.system
    hull = _solid("ellipsoid", (1.0, 1.0, 1.0), colour_of(*LOOK.inertia))
    yield Node(
        ("overlays", "locked inertia"), _at(film.com), (hull,), _circles(1.0, *LOOK.inertia_rings),
        stretch=film.ellipsoid,
    )  # fmt: skip
    if film.sphere is not None:
        placements = film.placements[:, film.sphere.joint].copy()
        placements[:, :3] = film.momentum.tail
        size = LOOK.arrow_length * radius
        sphere = _solid("sphere", (size,), colour_of(*LOOK.sphere))
        path = Line(size * film.sphere.path, colour_of(LOOK.sphere[0]))
        lines = (path, *_circles(size, *LOOK.sphere_rings))
        yield Node(("overlays", "momentum sphere"), placements, (sphere,), lines)
    base_axes = _axes(radius, *LOOK.base_axes)
    yield Node(("overlays", "base frame"), film.placements[:, 1], base_axes, order=_BEHIND)
    for ball in system.space.balls:
        joint = system.sorted_model.getJointId(ball.name)
        bodies_of_mark = (*_axes(radius, *LOOK.ball_axes), _dot(radius, *LOOK.ball))
        name = f"ball joint {ball.name}"
        yield Node(("overlays", name), film.placements[:, joint], bodies_of_mark, order=_BEHIND)
    if (arrow := momentum_arrow(film, framing)) is not None:
        yield from _arrow("momentum", arrow, radius, LOOK.momentum)
    if system.gravity.any():
        length = LOOK.gravity_length * radius
        arrow_vector = length * system.gravity / np.linalg.norm(system.gravity)
        middle = film.com + framing.gravity_at
        arrow = Arrow(middle - 0.5 * arrow_vector, np.broadcast_to(arrow_vector, middle.shape))
        yield from _arrow("gravity", arrow, radius, LOOK.gravity)
        dot = _dot(radius, LOOK.gravity[0], 1e-6)
        yield Node(
            ("overlays", "g"), _at(middle - 0.65 * arrow_vector), (dot,), order=_ABOVE, label="g"
        )
    trail = Line(film.com, colour_of(LOOK.mass[0]), grows=True)
    yield Node(("overlays", "trail"), _at(np.zeros_like(film.com)), lines=(trail,), order=_ABOVE)
    dot = _dot(radius, *LOOK.mass)
    yield Node(("overlays", "centre of mass"), _at(film.com), (dot,), order=_TOP)


def _flashes(film: Playback, framing: Framing, speed: float) -> Iterator[Node]:
    """Yield a ball for each joint that hits a stop, visible for a moment after each impact."""
    names = film.system.sorted_model.names
    for joint in np.unique(film.impacts[:, 1]).astype(int):
        times = np.sort(film.impacts[film.impacts[:, 1] == joint, 0])
        last = np.concatenate([[-np.inf], times])[np.searchsorted(times, film.t, side="right")]
        opacity = np.clip(1.0 - (film.t - last) / (LOOK.fade * speed), 0.0, 1.0)
        ball = _dot(framing.radius, *LOOK.impact)
        where = film.placements[:, joint]
        name = f"impact at {names[int(joint)]}"
        yield Node(("overlays", name), where, (ball,), opacity=opacity, order=_TOP)


def _arrow(name: str, arrow: Arrow, radius: float, look: ArrowLook) -> Iterator[Node]:
    """Yield the shaft and the tip of an arrow.

    Args:
        name: Name of the node.
        arrow: The arrow over time.
        radius: Radius of the robot [m].
        look: Colour and sizes of the arrow.
    Yields:
        The nodes.
    """
    colour, (thin, wide, head) = colour_of(look[0]), (radius * size for size in look[1:])
    lengths = np.linalg.norm(arrow.vector, axis=1)
    turns = np.array([_quaternion_to(vector) for vector in arrow.vector])
    visible = (lengths > 0.0).astype(float)
    stretch = np.zeros((len(lengths), 3, 3))
    stretch[:, 0, 0] = stretch[:, 1, 1] = 1.0
    stretch[:, 2, 2] = np.maximum(lengths - head, 1e-9 * head)
    up = np.array([0.0, 0.0, 0.5, 0.0, 0.0, 0.0, 1.0])
    shaft = _solid("cylinder", (thin, 0.5), colour, up, lit=False)
    tip = _solid("cone", (wide, 0.5 * head), colour, lit=False)
    placements = np.column_stack([arrow.tail, turns])
    yield Node(
        ("overlays", f"{name} shaft"), placements, (shaft,), stretch=stretch, opacity=visible,
        order=_ABOVE,
    )  # fmt: skip
    ends = placements.copy()
    ends[:, :3] += rotation(turns)[..., 2] * (lengths - 0.5 * head)[:, None]
    yield Node(("overlays", f"{name} tip"), ends, (tip,), opacity=visible, order=_ABOVE)


def _quaternion_to(vector: Array) -> Array:
    """Return a quaternion that turns the z axis to a vector; the identity for zero."""
    turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), vector)
    return np.array(turn.coeffs()) if vector.any() else _STILL[3:]


def _axes(radius: float, length: float, thin: float) -> tuple[Part, ...]:
    """Return red, green and blue rods along the axes of a node; sizes in radii of the robot."""
    size = (radius * thin, 0.5 * radius * length)
    return tuple(
        _solid(
            "cylinder", size, colour_of(colour),
            np.concatenate([size[1] * axis, _quaternion_to(axis)]), lit=False,
        )
        for axis, colour in zip(np.eye(3), LOOK.axes, strict=True)
    )  # fmt: skip


def _dot(radius: float, colour: str, size: float) -> Part:
    """Return a ball without shades; its size is in radii of the robot."""
    return _solid("sphere", (size * radius,), colour_of(colour), lit=False)


def colour_of(text: str, opacity: float = 1.0) -> Colour:
    """Return red, green, blue and opacity, from 0 to 1, of a colour "#rrggbb"."""
    red, green, blue = bytes.fromhex(text[1:])
    return red / 255.0, green / 255.0, blue / 255.0, opacity


def _circles(radius: float, colour: str, opacity: float) -> tuple[Line, ...]:
    """Return three equators of a sphere."""
    angle = np.linspace(0.0, 2.0 * np.pi, 97)
    circle = radius * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(97)])
    return tuple(Line(np.roll(circle, k, axis=1), colour_of(colour, opacity)) for k in range(3))


def _solid(
    kind: str, size: tuple[float, ...], colour: Colour, placement: Array = _STILL, lit: bool = True
) -> Part:
    return Part(
        solid_mesh(Solid(0, kind, size, placement, colour), ()), False, placement, colour, lit
    )


def _at(points: Array) -> Array:
    """Return placements at points, (F, 3), without rotation."""
    return np.column_stack([points, np.broadcast_to(_STILL[3:], (len(points), 4))])


def momentum_arrow(film: Playback, framing: Framing) -> Arrow | None:
    """Return the momentum arrow, which is as long as in pinred's page; None without momentum."""
    largest = float(np.linalg.norm(film.momentum.vector, axis=1).max())
    if largest == 0.0:
        return None
    scale = LOOK.arrow_length * framing.radius / largest
    return Arrow(film.momentum.tail, scale * film.momentum.vector)


def interpolate(t: Array, values: Array, time: float) -> Array:
    """Interpolate an array over frames, (F, …), linearly at a time within the film."""
    after = int(np.clip(np.searchsorted(t, time, side="right"), 1, len(t) - 1))
    share = float(np.clip((time - t[after - 1]) / (t[after] - t[after - 1]), 0.0, 1.0))
    if share in (0.0, 1.0):
        return np.array(values[after - 1 + int(share)])
    return np.asarray((1.0 - share) * values[after - 1] + share * values[after])


def interpolate_placements(t: Array, placements: Array, time: float) -> Array:
    """Interpolate placements (F, …, 7) at a time, with quaternions along the shortest arc.

    Args:
        t: Times of the frames, (F,) [s].
        placements: Positions [m] and quaternions.
        time: A time within the film [s].
    Returns:
        The placements, (…, 7).
    """
    after = int(np.clip(np.searchsorted(t, time, side="right"), 1, len(t) - 1))
    pair = placements[after - 1 : after + 1].copy()
    opposite = (pair[0, ..., 3:] * pair[1, ..., 3:]).sum(axis=-1) < 0.0
    pair[1, ..., 3:] *= np.where(opposite, -1.0, 1.0)[..., None]  # q and −q are the same rotation
    mean = interpolate(t[after - 1 : after + 1], pair, time)
    mean[..., 3:] /= np.linalg.norm(mean[..., 3:], axis=-1, keepdims=True)
    return mean


def _robot(
    name: str, film: Playback, placements: Array, bodies: Bodies, colour: Colour | None = None
) -> Iterator[Node]:
    """Yield a node of each joint with shapes.

    Args:
        name: First name of the nodes' paths.
        film: The motion.
        placements: Placements of the joints, (F, joints, 7).
        bodies: The shapes.
        colour: Colour of all shapes; their own if None.
    Yields:
        The nodes.
    """
    for joint, joint_name in enumerate(film.system.sorted_model.names):
        solids = [solid for solid in bodies.solids if solid.joint == joint]
        if solids:
            solids_of_joint = tuple(_part(solid, bodies.meshes, colour) for solid in solids)
            yield Node((name, f"{joint} {joint_name}"), placements[:, joint], solids_of_joint)


def _part(solid: Solid, meshes: Sequence[Mesh], colour: Colour | None = None) -> Part:
    mesh, flat = solid_mesh(solid, meshes), solid.kind == "mesh"
    return Part(mesh, flat, solid.placement, solid.colour if colour is None else colour)


ARROW = 1.3  # length of the momentum arrow with a margin, in radii of the robot
_SAMPLES = 200  # number of frames that determine the robot's radius
_BESIDE = 1.8  # distance between the robot and its ghost, in radii of the robot
# Distance of the gravity arrow to the left of the centre of mass, in radii of the robot. The arrow
# is half a radius long (player.js), so that it is within `reach` in any direction.
_LEFT = 0.8
_ELEVATION, _PLANAR_ELEVATION = 18.0, 50.0  # elevation of the camera [deg]
_DEEP = 5.0  # largest fall for which the grid is drawn as a floor, in radii of the robot
_FAR = 10.0  # half of the side length of the grid, in radii of the robot


@dataclass(frozen=True)
class Framing(FrozenArrays):
    """Framing of a film; vectors are (3,) in the world frame, lengths are in m.

    Attributes:
        radius: Radius of a ball about the centre of mass that contains the robot at all times.
        reach: Radius of such a ball that also contains the momentum arrow, but not the ghost.
        middle: Middle of the path of the centre of mass.
        span: Radius of a ball about `middle` that contains everything at all times.
        follow: Whether the camera should follow the robot.
        eye: Unit vector to the camera.
        aside: Offset from the robot to its ghost.
        gravity: Acceleration of gravity [m/s²].
        gravity_at: Offset from the centre of mass to the middle of the gravity arrow.
        cell: Side of the grid's squares.
        cells: Number of squares in a row of the grid, which follows the camera.
        wide: Factor on the size of the squares if the camera does not move and shows the whole
            path.
        grid: Centre of the grid if the camera looks at `middle`.
        normal: Unit normal of the grid: a floor, or a wall behind falling robots.
    """

    radius: float
    reach: float
    middle: Array
    span: float
    follow: bool
    eye: Array
    aside: Array
    gravity: Array
    gravity_at: Array
    cell: float
    cells: int
    wide: float
    grid: Array
    normal: Array


@dataclass(frozen=True)
class Camera(FrozenArrays):
    """A camera whose picture has z upwards; arrays are read-only.

    Attributes:
        position: Position, (3,) [m], relative to the centre of mass if the camera follows it.
        target: Point in the middle of the picture, (3,) [m], with the same origin.
        distance: Distance of both [m].
        reach: Radius of a ball about the target that contains everything at all times [m].
    """

    position: Array
    target: Array
    distance: float
    reach: float


def camera(framing: Framing, fov: float, *, follow: bool, aspect: float = 1.0) -> Camera:
    """Place a perspective camera that sees everything at all times.

    Args:
        framing: The framing of the film.
        fov: Vertical field of view [rad].
        follow: Whether the camera follows the centre of mass.
        aspect: Width of the picture divided by its height.
    Returns:
        The camera.
    """
    half = np.arctan(np.tan(0.5 * fov) * min(aspect, 1.0))
    target = 0.5 * framing.aside + (0.0 if follow else framing.middle)
    reach = framing.reach if follow else framing.span
    reach += 0.5 * float(np.linalg.norm(framing.aside))
    distance = float(LOOK.margin * reach / np.sin(half))
    return Camera(target + distance * framing.eye, target, distance, reach)


def frame(film: Playback, bodies: Bodies) -> Framing:
    """Compute a framing that shows the whole robot, with its momentum arrow in side view."""
    radius = _radius(film, bodies)
    low, high = film.com.min(axis=0), film.com.max(axis=0)
    middle = 0.5 * (low + high)
    path = float(np.linalg.norm(film.com - middle, axis=1).max())
    eye = _eye(film)
    right = np.cross([0.0, 0.0, 1.0], eye)
    right /= np.linalg.norm(right)
    aside = np.zeros(3) if film.ghost is None else _BESIDE * radius * right
    reach = 1.05 * radius
    if film.momentum.vector.any():
        arm = film.momentum.tail - film.com
        reach = ARROW * radius + float(np.linalg.norm(arm, axis=1).max())
    cell = _round_up(0.5 * radius)
    sideways = float(max((high - low)[:2]))
    falls = high[2] - low[2] > max(2.0 * radius, min(sideways, _DEEP * radius))
    normal, grid = np.array([0.0, 0.0, 1.0]), middle.copy()
    if falls:
        normal = np.append(eye[:2], 0.0) / np.linalg.norm(eye[:2])
        grid -= 1.5 * radius * normal
    else:
        grid[2] = low[2] - 1.1 * radius
    offsets = film.com - middle
    distances = np.linalg.norm(offsets - np.outer(offsets @ normal, normal), axis=1)
    cells = 2 * int(np.ceil(_FAR * radius / cell))
    wide = (float(distances.max()) + 6.0 * radius) / (0.5 * cells * cell)
    return Framing(
        radius=radius,
        reach=reach,
        middle=middle,
        span=reach + path,
        follow=path > radius,
        eye=eye,
        aside=aside,
        gravity=film.system.gravity,
        gravity_at=-_LEFT * radius * right,
        cell=cell,
        cells=cells,
        wide=_round_up(max(1.0, wide)),
        grid=grid,
        normal=normal,
    )


def _radius(film: Playback, bodies: Bodies) -> float:
    frames = np.unique(np.linspace(0, len(film.t) - 1, _SAMPLES).astype(int))
    com, most = film.com[frames], 0.0
    for joint, centre, radius in extents(bodies):
        if joint:
            pose = film.placements[frames, joint]
            points = pose[:, :3] + np.einsum("fij,j->fi", rotation(pose[:, 3:]), centre)
            most = max(most, float(np.linalg.norm(points - com, axis=1).max()) + radius)
    return most


def _eye(film: Playback) -> Array:
    """Return the camera direction that is most nearly perpendicular to the momentum arrow."""
    group = film.system.group
    planar = group.plane and group.linear == 2
    elevation = np.radians(_PLANAR_ELEVATION if planar else _ELEVATION)
    steps = np.arange(0.0, 181.0, 15.0)
    azimuth = np.radians(-60.0 + np.column_stack([-steps, steps]).ravel())
    eyes = np.column_stack(
        [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.full(len(azimuth), np.sin(elevation)),
        ]
    )
    overlap = np.abs(eyes @ film.momentum.vector.T).max(axis=1)
    return np.asarray(eyes[int(np.argmin(np.round(overlap / max(overlap.max(), 1e-300), 6)))])


def _round_up(length: float) -> float:
    """Round a length up to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** np.floor(np.log10(length))
    return float(next(step * power for step in (1, 2, 5, 10) if step * power >= length))
