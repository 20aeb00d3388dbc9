"""URDF of the arm, for robot_state_publisher, RViz, MoveIt and Foxglove.

Links `fss`, `fss_body`, `link_1` .. `link_n`, `end_effector`; joints `joint_1` .. `joint_n` as in
`joint_states`: a joint's frame is rotated by +theta_0 about z from the link before it, so that the
joint's position is the encoder's reading. The arm lies in the plane z = 0 of the base. The root
`fss` has no mass because KDL ignores the mass of a root; the base's mass is that of `fss_body`,
fixed to it.
The collision box of a link is its visual box; at a joint the boxes of neighbours overlap.
"""

from typing import NamedTuple
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from .description import Arm, Link

WIDTH, HEIGHT = 0.08, 0.06  # size of a link's box [m]
BASE_SIZE = 0.27  # size of the base's box [m]
SLENDER_RATIO = 1e-3  # moment about a link's long axis over that about z; must be positive
ROOT = "fss"


class Frame(NamedTuple):
    """Pose of a URDF link relative to its parent while its joint reads 0."""

    name: str
    parent: str
    x: float  # [m]
    y: float  # [m]
    theta: float  # [rad]
    joint: int = 0  # number of the joint that turns it; 0: fixed


def frames(arm: Arm) -> list[Frame]:
    """Return all links of the URDF except the root, parents first."""
    found = [Frame("fss_body", ROOT, 0.0, 0.0, 0.0)]
    parent, (x, y, theta) = ROOT, arm.base.mount
    for i, link in enumerate(arm.links, 1):
        found.append(Frame(f"link_{i}", parent, x, y, theta + link.theta_0, i))
        parent, x, y, theta = f"link_{i}", link.a, 0.0, 0.0
    return [*found, Frame("end_effector", parent, x, y, arm.theta_E)]


def urdf(arm: Arm) -> str:
    """Return the URDF of the arm as an XML document."""
    robot = Element("robot", name=arm.name)
    material = SubElement(robot, "material", name="link")
    SubElement(material, "color", rgba="0.75 0.77 0.80 1")
    SubElement(robot, "link", name=ROOT)
    for frame in frames(arm):
        _joint(robot, frame, arm)
        link = SubElement(robot, "link", name=frame.name)
        if frame.joint:
            of_arm = arm.links[frame.joint - 1]
            _inertial(link, of_arm.mass, of_arm.inertia, (of_arm.g, of_arm.lateral))
            _box(link, (of_arm.a, WIDTH, HEIGHT), (0.5 * of_arm.a, 0.0))
        elif frame.name == "fss_body":
            base = arm.base
            _inertial(link, base.mass, base.inertia, base.com)
            _box(link, (BASE_SIZE, BASE_SIZE, BASE_SIZE), base.com)
    indent(robot)
    return tostring(robot, encoding="unicode") + "\n"  # lxml rejects text that declares an encoding


def _joint(robot: Element, frame: Frame, arm: Arm) -> None:
    name = f"joint_{frame.joint}" if frame.joint else f"{frame.name}_fixed"
    joint = SubElement(robot, "joint", name=name, type="revolute" if frame.joint else "fixed")
    _add_origin(joint, (frame.x, frame.y, frame.theta))
    SubElement(joint, "parent", link=frame.parent)
    SubElement(joint, "child", link=frame.name)
    if frame.joint:
        SubElement(joint, "axis", xyz="0 0 1")
        SubElement(joint, "limit", _limits(arm.links[frame.joint - 1]))


def _limits(link: Link) -> dict[str, str]:
    limits = {
        "lower": link.q_min,
        "upper": link.q_max,
        "effort": link.drive.max_torque,
        "velocity": link.drive.max_velocity,
    }
    return {name: repr(value) for name, value in limits.items()}


def _inertial(link: Element, mass: float, inertia: float, com: tuple[float, float]) -> None:
    inertial = SubElement(link, "inertial")
    _add_origin(inertial, (*com, 0.0))
    SubElement(inertial, "mass", value=repr(mass))
    # Only izz is known, and alone matters in the plane; the others are those of a rod along x.
    moments = {"ixx": SLENDER_RATIO * inertia, "iyy": inertia, "izz": inertia}
    zeros = dict.fromkeys(("ixy", "ixz", "iyz"), 0.0)
    SubElement(inertial, "inertia", {k: repr(v) for k, v in {**moments, **zeros}.items()})


def _box(link: Element, size: tuple[float, float, float], center: tuple[float, float]) -> None:
    for kind in ("visual", "collision"):
        shape = SubElement(link, kind)
        _add_origin(shape, (*center, 0.0))
        SubElement(SubElement(shape, "geometry"), "box", size=" ".join(map(repr, size)))
    SubElement(link[1], "material", name="link")


def _add_origin(element: Element, pose: tuple[float, float, float]) -> None:
    x, y, theta = pose
    SubElement(element, "origin", xyz=f"{x!r} {y!r} 0", rpy=f"0 0 {theta!r}")
