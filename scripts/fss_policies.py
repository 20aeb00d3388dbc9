"""SROS 2 policies: governance and the permissions of each node for DDS security.

A process without a certificate can neither subscribe nor publish. With one it may subscribe to all
topics, but publish, offer and call only what its node needs: a compromised view moves nothing.
ROS's names become DDS's as rmw has it: `rt` before a topic, `rq` and `rr` before a service's
requests and replies, an action is three services and two topics.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple
from xml.etree.ElementTree import Element, SubElement, indent, tostring

SCHEMA_PREFIX = "http://www.omg.org/spec/DDS-SECURITY/20170901/omg_shared_ca_"
ACTION_SERVICES = ("send_goal", "get_result", "cancel_goal")
ACTION_TOPICS = ("feedback", "status")


class Access(NamedTuple):
    """Permissions of a node besides subscribing; `*` matches any part of a name."""

    publishes: str = ""
    offers: str = ""  # services
    runs: str = ""  # actions
    calls: str = ""  # services
    asks: str = ""  # actions

    def __or__(self, other: "Access") -> "Access":
        """Return the permissions of both."""
        return Access(*(f"{a} {b}" for a, b in zip(self, other, strict=True)))


#: ROS interfaces of every node.
COMMON = Access(
    publishes="/rosout /parameter_events /diagnostics",
    offers="*/describe_parameters */get_parameters */set_parameters */list_parameters "
    "*/set_parameters_atomically */get_parameter_types */get_type_description",
)
LINK = Access(
    "joint_states link_*/telemetry link_*/battery link_*/command_status",
    offers="link_*/arm link_*/clear_faults",
)
ARM = Access(
    "arm/joint_states arm/planned link_*/command link_*/path robot_description /tf /tf_static",
    offers="arm/enable",
    runs="arm/move arm_controller/follow_joint_trajectory",
    calls="link_*/arm",
)
#: Permissions by package and executable; all others may only subscribe.
ACCESS = {
    "fss_arm_bags record": Access(),
    "fss_arm_view view": Access(),
    "fss_arm_driver link": LINK,
    "fss_arm_driver arm": ARM,
    "fss_arm_driver driver": LINK | ARM,
    "fss_arm_motion motion": Access(
        "arm/motion arm_controller/alive",
        runs="arm/execute",
        asks="arm_controller/follow_joint_trajectory",
    ),
    "fss_arm_view base_reaction": Access("base/state base_reaction /tf"),
    "fss_arm_workspace workspace": Access("workspace/*"),
    "fss_arm_calib kinematic": Access(
        "calibration/kinematic calibration/observations", "kinematic/solve kinematic/forget"
    ),
    "fss_arm_calib dynamic": Access(
        "calibration/dynamic calibration/maneuvers", "dynamic/solve dynamic/forget"
    ),
    "fss_arm_calib drift": Access(
        "calibration/drift calibration/drifts", "drift/solve drift/forget"
    ),
    "fss_arm_calib drives": Access(
        "calibration/drives calibration/excitations", "drives/solve drives/forget"
    ),
    "fss_arm_calib joint": Access(
        "calibration/joint calibration/session", "joint/solve joint/forget"
    ),
    "fss_arm_calib experiment": Access("arm/move/alive", asks="arm/move"),
    "fss_base_driver base": Access(
        "base/battery base/pressure base/propellant base/telemetry fog/imu gripper/state "
        "thrusters/pulses",
        offers="base/arm base/find_gyro_bias",
    ),
    "fss_base_driver fog": Access("fog/imu"),
    "fss_base_driver mocap": Access("vicon/* /vicon/*", offers="mocap/accept"),
    "fss_gnc navigation": Access(
        "base/state target/state target/mass_properties thrusters/health /tf"
    ),
    "fss_gnc control": Access("base/wrench control/stall"),
    "fss_gnc controller": Access(
        "arm/joint_commands base/wrench gripper/command thrusters/command"
    ),
    "fss_gnc guidance": Access(
        "arm/joint_commands base/footprint base/plan base/trajectory gripper/command mission/state",
        runs="base/follow base/go_to base/hold mission/abort mission/capture mission/detumble",
    ),
    "fss_sim testbed": Access(
        "fog/imu gripper/state thrusters/pulses sim/faults sim/truth vicon/* /vicon/* /clock",
        offers="sim/charge sim/pause sim/reset sim/step",
    ),
}
#: Permissions of an operator, for all vehicles.
OPERATOR = Access(
    "/*arm/stop /*arm/joint_commands /*arm/move/alive /*arm_controller/alive "
    "/*arm_controller/joint_trajectory /*link_*/command /*link_*/path /*base/stop /*base/wrench "
    "/*base/trajectory /*thrusters/command /*gripper/command",
    calls="/*",
    asks="/*",
)


def permissions(
    enclave: str, access: Access, domain: int, valid: tuple[str, str], namespace: str = ""
) -> str:
    """Return the permissions of an enclave as XML to sign.

    Args:
        enclave: its name, also the common name of its certificate.
        access: permissions besides COMMON.
        domain: ROS domain.
        valid: start and end, such as 2026-01-31T12:00:00.
        namespace: namespace of its node, such as `fss2`; empty: none.
    """
    root = _root("permissions")
    grant = SubElement(SubElement(root, "permissions"), "grant", name=enclave)
    SubElement(grant, "subject_name").text = f"CN={enclave}"
    validity = SubElement(grant, "validity")
    for tag, when in zip(("not_before", "not_after"), valid, strict=True):
        SubElement(validity, tag).text = when
    rule = SubElement(grant, "allow_rule")
    _domain(rule, domain)
    says, hears = topics(COMMON | access, namespace)
    _topics(rule, "publish", says)
    _topics(rule, "subscribe", hears)
    SubElement(grant, "default").text = "DENY"
    return _text(root)


def governance(domain: int) -> str:
    """Return a governance that encrypts everything and requires permissions, as XML to sign."""
    root = _root("governance")
    rule = SubElement(SubElement(root, "domain_access_rules"), "domain_rule")
    _domain(rule, domain)
    _values(
        rule,
        {
            "allow_unauthenticated_participants": "false",
            "enable_join_access_control": "true",
            "discovery_protection_kind": "ENCRYPT",
            "liveliness_protection_kind": "ENCRYPT",
            "rtps_protection_kind": "SIGN",
        },
    )
    topic = SubElement(SubElement(rule, "topic_access_rules"), "topic_rule")
    _values(
        topic,
        {
            "topic_expression": "*",
            "enable_discovery_protection": "true",
            "enable_liveliness_protection": "true",
            "enable_read_access_control": "true",
            "enable_write_access_control": "true",
            "metadata_protection_kind": "ENCRYPT",
            "data_protection_kind": "ENCRYPT",
        },
    )
    return _text(root)


def topics(access: Access, namespace: str = "") -> tuple[list[str], list[str]]:
    """Return the DDS topics that a node may publish on, and those it may subscribe to."""

    def full(names: str) -> list[str]:
        space = f"/{namespace.strip('/')}".rstrip("/")
        return [name if name.startswith("/") else f"{space}/{name}" for name in names.split()]

    actions = {True: full(access.runs), False: full(access.asks)}
    served = [*full(access.offers), *_each(actions[True], ACTION_SERVICES)]
    called = [*full(access.calls), *_each(actions[False], ACTION_SERVICES)]
    told = [*full(access.publishes), *_each(actions[True], ACTION_TOPICS)]
    replies, requests = "rr{}Reply".format, "rq{}Request".format
    says = ["ros_discovery_info", *(f"rt{name}" for name in told)]
    says += [*map(replies, served), *map(requests, called)]
    hears = ["ros_discovery_info", "rt/*", *map(requests, served), *map(replies, called)]
    return sorted(set(says)), sorted(set(hears))


def _each(actions: Iterable[str], parts: Iterable[str]) -> Iterator[str]:
    return (f"{action}/_action/{part}" for action in actions for part in parts)


def _root(what: str) -> Element:
    schema = "http://www.w3.org/2001/XMLSchema-instance"
    return Element(
        "dds", {"xmlns:xsi": schema, "xsi:noNamespaceSchemaLocation": f"{SCHEMA_PREFIX}{what}.xsd"}
    )


def _domain(rule: Element, domain: int) -> None:
    SubElement(SubElement(rule, "domains"), "id").text = str(domain)


def _values(parent: Element, values: Mapping[str, str]) -> None:
    for tag, value in values.items():
        SubElement(parent, tag).text = value


def _topics(rule: Element, what: str, names: Iterable[str]) -> None:
    listed = SubElement(SubElement(rule, what), "topics")
    for name in names:
        SubElement(listed, "topic").text = name


def _text(root: Element) -> str:
    indent(root)
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{tostring(root, encoding="unicode")}\n'
