"""The arm as URDF, for robot_state_publisher, RViz and Foxglove.

Links `fss`, `fss_body`, `link_1` .. `link_n`, `end_effector`; joints `joint_1` .. `joint_n` as in
`joint_states`: a joint's frame is turned by theta_0 against the link before it, so that the joint's
position is the encoder's reading. The arm lies in the plane z = 0 of the base. The root `fss` has
no mass, as KDL ignores that of a root: the base's is that of `fss_body`, fixed to it.
"""

from xml.etree.ElementTree import Element, SubElement, indent, tostring

from fss_arm_model.description import Arm, Link

WIDTH, HEIGHT = 0.08, 0.06  # of a link as drawn [m]
BASE_SIZE = 0.27  # of the base [m]
SLENDER = 1e-3  # of the moment about z, about the link's own axis: a solid body has some


def urdf(arm: Arm) -> str:
    """The description as an XML document."""
    robot = Element("robot", name=arm.name)
    material = SubElement(robot, "material", name="link")
    SubElement(material, "color", rgba="0.75 0.77 0.80 1")
    SubElement(robot, "link", name="fss")
    _fixed(robot, "fss_body", "fss", (0.0, 0.0, 0.0))
    base = _link(robot, "fss_body", arm.base.mass, arm.base.inertia, arm.base.com)
    _box(base, (BASE_SIZE, BASE_SIZE, BASE_SIZE), arm.base.com)
    x, y, theta = arm.base.mount
    parent, origin = "fss", (x, y, theta)
    for i, link in enumerate(arm.links, 1):
        _joint(robot, i, parent, link, origin)
        parent = f"link_{i}"
        body = _link(robot, parent, link.mass, link.inertia, (link.g, link.lateral))
        _box(body, (link.a, WIDTH, HEIGHT), (0.5 * link.a, 0.0))
        origin = link.a, 0.0, 0.0
    _fixed(robot, "end_effector", parent, (origin[0], 0.0, arm.theta_E))
    SubElement(robot, "link", name="end_effector")
    indent(robot)
    return tostring(robot, encoding="unicode") + "\n"  # a text with an encoding is refused by lxml


def _fixed(robot: Element, child: str, parent: str, pose: tuple[float, float, float]) -> None:
    joint = SubElement(robot, "joint", name=f"{child}_fixed", type="fixed")
    _place(joint, pose)
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)


def _joint(
    robot: Element, i: int, parent: str, link: Link, origin: tuple[float, float, float]
) -> None:
    joint = SubElement(robot, "joint", name=f"joint_{i}", type="revolute")
    _place(joint, (*origin[:2], origin[2] + link.theta_0))
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=f"link_{i}")
    SubElement(joint, "axis", xyz="0 0 1")
    limits = {
        "lower": link.q_min,
        "upper": link.q_max,
        "effort": link.drive.max_torque,
        "velocity": link.drive.max_velocity,
    }
    SubElement(joint, "limit", {name: repr(value) for name, value in limits.items()})


def _link(
    robot: Element, name: str, mass: float, inertia: float, com: tuple[float, float]
) -> Element:
    link = SubElement(robot, "link", name=name)
    inertial = SubElement(link, "inertial")
    _place(inertial, (*com, 0.0))
    SubElement(inertial, "mass", value=repr(mass))
    # Only the moment about z is known; the others are those of a slender rod along x.
    moments = {"ixx": SLENDER * inertia, "iyy": inertia, "izz": inertia}
    zeros = dict.fromkeys(("ixy", "ixz", "iyz"), 0.0)
    SubElement(inertial, "inertia", {k: repr(v) for k, v in {**moments, **zeros}.items()})
    return link


def _box(link: Element, size: tuple[float, float, float], centre: tuple[float, float]) -> None:
    visual = SubElement(link, "visual")
    _place(visual, (*centre, 0.0))
    SubElement(SubElement(visual, "geometry"), "box", size=" ".join(map(repr, size)))
    SubElement(visual, "material", name="link")


def _place(element: Element, pose: tuple[float, float, float]) -> None:
    x, y, theta = pose
    SubElement(element, "origin", xyz=f"{x!r} {y!r} 0", rpy=f"0 0 {theta!r}")
