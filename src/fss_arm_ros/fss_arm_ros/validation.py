"""Validation of messages before a node's callbacks receive them.

Any process on the network may publish anything. A rule declares what the subscribers of a type of
message rely on: size, numbers that may be missing, arrays of equal length. RULES has those of types
that several packages receive; a subscriber gives the rule of another type. For all types, numbers
are finite and small enough for arithmetic, and times are after 1970. Other messages are rejected,
counted in diagnostics and logged, at most once per LOG_PERIOD.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from importlib import import_module
from math import isfinite, isnan
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message

from fss_arm_ros.convert import PoseError, planar_pose
from fss_arm_ros.rules import ANY_FIELD, RESULT, Check, Rule
from fss_arm_ros.subscription_set import subscribe_bytes

MAX_MAGNITUDE = 1e12  # of any number: its cube is still far from the largest double
LOG_PERIOD = 10.0  # between two log lines about one topic [s]
# An attribute of the node: any other reference would keep the node alive.
VALIDATORS = "_validators"


def _is_pose(message: Any) -> str:
    """Check that an estimate is a valid pose."""
    try:
        planar_pose(message.pose.pose)
    except PoseError as error:
        return str(error)
    return ""


ESTIMATES = ("names", "units", "values", "initial", "deviations")

RULES = {
    "fss_arm_msgs/BaseReaction": Rule(ANY_FIELD),
    "fss_arm_msgs/BaseTelemetry": Rule(frozenset({"clock_deviation", "round_trip"})),
    "fss_arm_msgs/Calibration": Rule(ANY_FIELD, (ESTIMATES,), (("covariance", "names"),)),
    "fss_arm_msgs/DynamicCalibration": RESULT,
    "fss_arm_msgs/GripperState": Rule(ANY_FIELD),
    "fss_arm_msgs/KinematicCalibration": RESULT,
    "fss_arm_msgs/LinkCommand": Rule(ANY_FIELD),  # drivers reject with a reason
    "fss_arm_msgs/LinkPath": Rule(ANY_FIELD, size=1_600_000),  # as long as a path may be
    "fss_arm_msgs/LinkTelemetry": Rule(frozenset({"clock_deviation", "round_trip"})),
    "fss_arm_msgs/MissionState": Rule(ANY_FIELD),
    "fss_arm_msgs/ThrusterCommand": Rule(ANY_FIELD),
    "geometry_msgs/PoseStamped": Rule(ANY_FIELD),  # zero or NaN if the subject is occluded
    "geometry_msgs/WrenchStamped": Rule(ANY_FIELD),
    "nav_msgs/Odometry": Rule(also=(_is_pose,)),
    "sensor_msgs/BatteryState": Rule(ANY_FIELD),
    "sensor_msgs/JointState": Rule(
        frozenset({"position", "velocity", "effort"}),
        (("name", "position"), ("name", "velocity"), ("name", "effort")),
    ),
    "trajectory_msgs/JointTrajectory": Rule(size=4_000_000),  # 10,000 points of 12 joints
    "trajectory_msgs/MultiDOFJointTrajectory": Rule(size=1_000_000),
    "visualization_msgs/MarkerArray": RESULT,
}


def type_name(kind: type) -> str:
    """Return the name of a type of message, as in RULES."""
    return f"{kind.__module__.partition('.')[0]}/{kind.__name__}"


@cache
def check(kind: type, rule: Rule | None = None, may_lack: bool = False) -> Check:
    """Return a function that returns the reason to reject a message, or an empty string.

    Args:
        kind: of message.
        rule: of the message; None: that of its type. Messages in it have the rule of their type.
        may_lack: any number may be NaN or infinite.
    """
    if kind.__name__ == "Time" and kind.__module__.startswith("builtin_interfaces"):
        return _time
    rule = rule or RULES.get(type_name(kind), Rule())
    rule = rule._replace(unknown=ANY_FIELD) if may_lack else rule
    checks = [*_lengths(rule), *_numbers(kind, rule), *_members(kind, rule), *rule.also]

    def problem(message: Any) -> str:
        return next(filter(None, (one(message) for one in checks)), "")

    return problem


def _time(time: Any) -> str:
    if time.sec >= 0 and time.nanosec < 1_000_000_000:
        return ""
    return f"a time is {time.sec} s and {time.nanosec} ns, expected one from 1970 on"


def _lengths(rule: Rule) -> Iterator[Check]:
    for first, *others in rule.alike:
        yield from (_length(name, first, 1) for name in others)
    yield from (_length(matrix, of, 2) for matrix, of in rule.square)


def _length(name: str, of: str, power: int) -> Check:
    def problem(message: Any) -> str:
        count, expected = len(getattr(message, name)), len(getattr(message, of)) ** power
        if count in (0, expected):
            return ""
        return f"{name} has {count} elements, expected {expected}, or none"

    return problem


def _numbers(kind: Any, rule: Rule) -> Iterator[Check]:
    for name, of in kind.get_fields_and_field_types().items():
        if of.partition("[")[0].removeprefix("sequence<").rstrip(">") not in _FLOATS:
            continue
        make = _number if of in _FLOATS else _array
        yield make(name, _may_lack(rule, name))


def _may_lack(rule: Rule, name: str) -> bool:
    return "*" in rule.unknown or name in rule.unknown


_FLOATS = ("double", "float")


def _number(name: str, may_lack: bool) -> Check:
    def problem(message: Any) -> str:
        value = getattr(message, name)
        in_range = -MAX_MAGNITUDE <= value <= MAX_MAGNITUDE
        return "" if in_range else _range_problem(name, value, may_lack)

    return problem


def _array(name: str, may_lack: bool) -> Check:
    def problem(message: Any) -> str:
        for value in getattr(message, name).tolist():  # for arrays of rclpy and of numpy
            if -MAX_MAGNITUDE <= value <= MAX_MAGNITUDE:
                continue
            if found := _range_problem(name, value, may_lack):
                return found
        return ""

    return problem


def _range_problem(name: str, value: float, may_lack: bool) -> str:
    if may_lack and not isfinite(value):
        return ""
    kind = "a number" if isnan(value) else f"at most {MAX_MAGNITUDE:g} in size"
    return f"{name} is {value:g}, expected {kind}"


def _members(kind: Any, rule: Rule) -> Iterator[Check]:
    """Yield the checks of nested messages."""
    for name, slot in zip(kind.get_fields_and_field_types(), kind.SLOT_TYPES, strict=True):
        inner = getattr(slot, "value_type", slot)  # of an array's elements
        if hasattr(inner, "namespaces"):
            module = import_module(".".join(inner.namespaces))
            one = check(getattr(module, inner.name), may_lack=_may_lack(rule, name))
            yield _member(name, one, inner is not slot)


def _member(name: str, one: Check, many: bool) -> Check:
    def of_one(message: Any) -> str:
        return one(getattr(message, name))

    def of_many(message: Any) -> str:
        return next(filter(None, map(one, getattr(message, name))), "")

    return of_many if many else of_one


class Validator:
    """Validates the messages of one topic of a node, and counts those it rejects.

    Args:
        node: the subscriber.
        kind: message type.
        topic: topic name.
        rule: of the messages; None: that of their type.
    """

    def __init__(self, node: Node, kind: type, topic: str, rule: Rule | None = None) -> None:
        self._node, self.kind, self.topic = node, kind, topic
        self._check, self.refused, self.reason = check(kind, rule), 0, ""
        self.most = (rule or RULES.get(type_name(kind), Rule())).size
        self._logged = -LOG_PERIOD
        vars(node).setdefault(VALIDATORS, []).append(self)

    def accepts(self, message: Any) -> bool:
        """Return True if the rule allows a message; count it otherwise."""
        why = self._check(message)
        if why:
            self.refuse(why)
        else:
            self.reason = ""
        return not why

    def message(self, data: bytes) -> Any:
        """Return the message in these bytes; None if there is none or it is rejected."""
        if len(data) > self.most:
            self.refuse(f"it has {len(data)} bytes, expected at most {self.most}")
            return None
        try:
            message = deserialize_message(data, self.kind)
        except RuntimeError:  # raised by rclpy's extension for bytes of another type
            self.refuse(f"its {len(data)} bytes are no {type_name(self.kind)}")
            return None
        return message if self.accepts(message) else None

    def refuse(self, why: str) -> None:
        """Count a rejected message; log the first of a row, at most once per LOG_PERIOD."""
        now = time.monotonic()
        if not self.reason and now >= self._logged + LOG_PERIOD:
            self._logged = now
            self._node.get_logger().warning(f"a message on {self.topic} is refused: {why}")
        self.refused, self.reason = self.refused + 1, why


def validators(node: Node) -> Sequence[Validator]:
    """Return the validators of a node."""
    return tuple(vars(node).get(VALIDATORS, ()))


def refusals(node: Node) -> dict[str, int]:
    """Return the number of rejected messages by topic."""
    return {f"refused on {each.topic}": each.refused for each in validators(node) if each.refused}


def subscribe(
    node: Node,
    kind: type,
    topic: str,
    callback: Callable[[Any], None],
    qos: QoSProfile | int,
    rule: Rule | None = None,
    **options: Any,
) -> Any:
    """Create a subscription whose callback gets only messages that a rule allows.

    The rule is that of their type if None is given. Options as of `Node.create_subscription`. To
    destroy it, call `unsubscribe`.
    """
    validator = Validator(node, kind, topic, rule)

    def receive(data: bytes) -> None:
        message = validator.message(data)
        if message is not None:
            callback(message)

    return subscribe_bytes(node, kind, topic, receive, qos, **options)
