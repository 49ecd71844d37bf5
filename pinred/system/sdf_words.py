"""Table of the elements and attributes of SDF 1.4 to 1.12 and of Drake's extensions.

Each word is read, harmless, reported as left out, or refused.  A word that is in no table is
reported, with its line.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

ANY = "*"  # key of a table for all words without a key of their own
WIND, STATES, PLUGINS, CONTACT = "wind", "initial states in the file", "plugins", "contact"
BUOYANCY, GRIPPERS, UNKNOWN = "buoyancy", "grippers", "unknown words"
REPEATED = "repeated elements"
ADDED_MASS, BUSHINGS = "added mass of a fluid", "bushings"
LINK_SPRINGS, TENDONS = "springs between links", "tendons"
CONTROLLERS, MOTORS = "controllers", "motors of joints"
NAMESPACES = ("xmlns", "xsi:", "xml:")  # beginnings of attributes without a meaning for robots

_DEFORMABLE = "pinred reads rigid links only; remove the link"


class Use(Enum):
    """What the reader does with a word."""

    READ = "read"
    HARMLESS = "harmless"
    LEFT_OUT = "left out"
    REFUSED = "refused"


@dataclass(frozen=True)
class Word:
    """An element or attribute of SDF.

    Attributes:
        use: What the reader does with it.
        kind: Kind of action (LeftOut.what) if it is left out, or the remedy if it is refused.
        table: Name of the table of its contents; "" if these are not examined.
        drake: Whether Drake gets the word.
        idle: Values without effect, which are not reported.
    """

    use: Use
    kind: str = ""
    table: str = ""
    drake: bool = False
    idle: tuple[str, ...] = ()

    def is_idle(self, text: str) -> bool:
        """Return whether a value has no effect; "0" stands for any list of zeros."""
        value = " ".join(text.split()).lower()
        if value in self.idle:
            return True
        try:
            return "0" in self.idle and value != "" and not any(map(float, value.split()))
        except ValueError:
            return False


def _read(table: str = "value") -> Word:
    """Return a word that pinred reads from the file."""
    return Word(Use.READ, table=table)


def _drake(table: str = "value") -> Word:
    """Return a word that Drake gets."""
    return Word(Use.READ, table=table, drake=True)


def _left(kind: str, *idle: str) -> Word:
    return Word(Use.LEFT_OUT, kind, idle=idle)


def _refused(remedy: str) -> Word:
    return Word(Use.REFUSED, remedy)


_HARMLESS = Word(Use.HARMLESS)
_VALUE, _GIVEN = _read(), _drake()


def _harmless(names: str) -> dict[str, Word]:
    return dict.fromkeys(names.split(), _HARMLESS)


def _given(names: str) -> dict[str, Word]:
    return dict.fromkeys(names.split(), _GIVEN)


_POSE, _JOINT, _AXIS, _FRAME = _drake("pose"), _drake("joint"), _drake("axis"), _drake("frame")
_PLUGIN, _STATE = _left(PLUGINS), _left(STATES)
_WINDY, _MODEL, _INCLUDE = _left(WIND, "false", "0"), _drake("model"), _drake("include")

# Contents by element.  Keys with @ are attributes.
TABLES: Mapping[str, Mapping[str, Word]] = {
    "value": {},
    "sdf": {
        "@version": _GIVEN,
        "model": _MODEL,
        "world": _drake("world"),
        "include": _INCLUDE,
        **_harmless("light actor"),
    },
    "world": {
        "@name": _GIVEN,
        "model": _MODEL,
        "include": _INCLUDE,
        "joint": _JOINT,
        "frame": _FRAME,
        "gravity": _VALUE,
        "physics": _read("physics"),
        "wind": _left(WIND, "0"),
        "state": _STATE,
        "population": _left("populations of models"),
        "plugin": _PLUGIN,
        **_harmless(
            "light actor gui scene road audio spherical_coordinates magnetic_field atmosphere"
        ),
    },
    "physics": {"gravity": _VALUE, ANY: _HARMLESS, f"@{ANY}": _HARMLESS},
    "model": {
        **_given("@name @canonical_link @placement_frame"),
        "@namespace": _HARMLESS,
        "static": _GIVEN,
        "pose": _POSE,
        "link": _drake("link"),
        "joint": _JOINT,
        "frame": _FRAME,
        "model": _MODEL,
        "include": _INCLUDE,
        "enable_wind": _WINDY,
        "gripper": _left(GRIPPERS),
        "plugin": _PLUGIN,
        "model_state": _STATE,
        "drake:joint": _drake("drake:joint"),
        "drake:ball_constraint": _read("drake:ball_constraint"),
        "drake:linear_bushing_rpy": _left(BUSHINGS),
        "drake:linear_spring_damper": _left(LINK_SPRINGS),
        "drake:tendon_constraint": _left(TENDONS),
        "drake:distance_constraint": _refused(
            "pinred has no rod of fixed length; insert a link with two ball joints"
        ),
        **_harmless("self_collide allow_auto_disable drake:collision_filter_group"),
    },
    "include": {
        "@merge": _GIVEN,
        "uri": _VALUE,
        "pose": _POSE,
        **_given("name placement_frame static"),
        "namespace": _HARMLESS,
        "plugin": _PLUGIN,
        "model_state": _STATE,
        "experimental:params": _refused("change the included file instead"),
    },
    "pose": _given("@relative_to @frame @degrees @rotation_format"),
    "frame": {**_given("@name @attached_to"), "pose": _POSE},
    "link": {
        "@name": _GIVEN,
        "pose": _POSE,
        "inertial": _drake("inertial"),
        "gravity": _VALUE,
        "collision": Word(Use.READ),
        "enable_wind": _WINDY,
        "kinematic": _left("links that do not feel forces", "false", "0"),
        "velocity_decay": _left("decay of velocities", "0", ""),
        "plugin": _PLUGIN,
        "drake:surface_velocity_axis": _left(CONTACT, "0"),
        "drake:deformable_properties": _refused(_DEFORMABLE),
        "drake:wall_boundary_condition": _refused(_DEFORMABLE),
        **_harmless(
            "visual sensor light projector particle_emitter audio_source audio_sink battery "
            "self_collide must_be_base_link drake:visual frame"
        ),
    },
    "inertial": {
        "pose": _POSE,
        "inertia": _drake("inertia"),
        **_given("@auto mass density"),
        **_harmless("auto_inertia_params frame"),
        "fluid_added_mass": _left(ADDED_MASS, "0", ""),
    },
    "inertia": _given("ixx iyy izz ixy ixz iyz"),
    "joint": {
        "pose": _POSE,
        "frame": _HARMLESS,
        "axis": _AXIS,
        "axis2": _AXIS,
        **_given("@name @type parent child"),
        "thread_pitch": _VALUE,
        "screw_thread_pitch": _VALUE,
        **_given("gearbox_ratio gearbox_reference_body drake:rotor_inertia drake:gear_ratio"),
        "physics": _read("joint physics"),
        "sensor": _HARMLESS,
        "plugin": _PLUGIN,
        "drake:controller_gains": _left(CONTROLLERS),
        "drake:mimic": _read("drake:mimic"),
    },
    "joint physics": {"ode": _read("ode"), **_harmless("simbody provide_feedback")},
    "ode": {
        "max_force": _left(MOTORS, "0"),
        **_harmless(
            "provide_feedback cfm_damping implicit_spring_damper fudge_factor cfm erp bounce "
            "velocity limit suspension"
        ),
    },
    "axis": {
        "xyz": _drake("xyz"),
        "use_parent_model_frame": _GIVEN,
        "dynamics": _read("dynamics"),
        "limit": _drake("limit"),
        "mimic": _read("mimic"),
        "initial_position": _left(STATES, "0"),
    },
    "xyz": {"@expressed_in": _GIVEN},
    "dynamics": dict.fromkeys(
        ("damping", "friction", "spring_stiffness", "spring_reference"), _VALUE
    ),
    "limit": {
        "lower": _VALUE,
        "upper": _VALUE,
        "velocity": _VALUE,
        "effort": _GIVEN,
        "drake:acceleration": _left("acceleration limits"),
        **_harmless("stiffness dissipation"),
    },
    "mimic": dict.fromkeys(("@joint", "@axis", "multiplier", "offset", "reference"), _VALUE),
    "drake:mimic": dict.fromkeys(("@joint", "@multiplier", "@offset"), _VALUE),
    "drake:joint": {
        **_given("@name @type drake:parent drake:child drake:damping"),
        # Words of curvilinear joints, which pinred refuses.
        **_harmless("drake:initial_tangent drake:plane_normal drake:curves drake:is_periodic"),
    },
    "drake:ball_constraint": {
        f"drake:ball_constraint_{part}": _VALUE for part in ("body_A", "p_AP", "body_B", "p_BQ")
    },
}

# Words that later versions of SDF do not define, and the first of these versions.  Gazebo ignores
# them there.
REMOVED = {"use_parent_model_frame": (1, 7), "@frame": (1, 7)}

# Elements of which a file may have several; of others only the first is read.
SEVERAL = {
    *("model", "include", "link", "joint", "frame", "collision", "mimic", "physics"),
    *("drake:joint", "drake:ball_constraint", "drake:mimic"),
}

# Parts of collision shapes that Drake gets for links whose inertia follows from their shapes.
SHAPE = ("pose", "geometry", "density")

# Systems of Gazebo that apply no forces.
_IDLE_SYSTEMS = (
    "physics|user-commands|scene-broadcaster|sensors|contact|imu|altimeter|air-pressure|air-speed|"
    "magnetometer|navsat|forcetorque|force-torque|logical-camera|label|particle-emitter2?|"
    "joint-state-publisher|pose-publisher|odometry-publisher|log|log-playback|"
    "performer-detector|camera-video-recorder|rgbd-camera|optical-tactile-plugin|"
    "shader-param|environment-preload|triggered-publisher|touchplugin|kinetic-energy-monitor"
)
# Plugins of Gazebo classic that apply no forces: sensors, and publishers of states.
_IDLE_CLASSIC = (
    r"gazebo_ros_((multi|triggered_|triggered_multi)?camera|depth_camera|openni_kinect|prosilica|"
    r"imu|imu_sensor|(gpu_|block_)?laser|range|ray_sensor|gps|gps_sensor|bumper|contact|ft_sensor|"
    r"p3d|f3d|joint_state_publisher|pub_robot_state|power_monitor|video|projector|clock|init|"
    r"factory|state|properties)|gazebo_world_odometry|realsense_gazebo_plugin|"
    r"hector_gazebo_ros_(imu|gps|magnetic|sonar|baro)|"
    r"gazebo_(imu|gps|barometer|magnetometer|lidar|sonar|opticalflow|groundtruth)_plugin"
)
_IDLE_PLUGIN = re.compile(
    rf"(lib)?((gz|ignition)-(sim|gazebo)\d*-({_IDLE_SYSTEMS})-system|{_IDLE_CLASSIC})(\.so)?"
)
# Plugins of URDF files for ROS that act on commands, or couple the joints of hands.
_COMMANDED_PLUGIN = re.compile(
    r"(lib)?(gazebo_ros_(control|controller_manager|force|planar_move|diff_drive)|gazebo_ros2_control|"
    r"(gz|ign)_ros2_control(-system)?|roboticsgroup_gazebo_mimic_joint_plugin|"
    r"gazebo_underactuated_finger)(\.so)?"
)


def plugin_kind(filename: str) -> str:
    """Return the kind of action of a plugin; "" if it applies no forces.

    Args:
        filename: Name of its library.
    """
    name = _library(filename)
    if _IDLE_PLUGIN.fullmatch(name):
        return ""
    return BUOYANCY if "buoyancy" in name else PLUGINS


def waits_for_commands(filename: str) -> bool:
    """Return whether a plugin acts on commands only, or couples the joints of a hand."""
    return _COMMANDED_PLUGIN.fullmatch(_library(filename)) is not None


def _library(filename: str) -> str:
    return filename.strip().lower().rpartition("/")[2]
