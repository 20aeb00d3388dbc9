"""Joint estimate as a calibration kind: its inputs from the other nodes, and its messages."""

from collections.abc import Sequence
from dataclasses import replace
from math import inf
from typing import Any

from fss_arm_calib import checks
from fss_arm_calib.acceptance import format_count
from fss_arm_calib.calibration import Calibration, Data, Input
from fss_arm_calib.joint.calibrate import Session, Solution, calibrate
from fss_arm_calib.joint.gathering import SessionCollector, SessionData
from fss_arm_calib.joint.report import joint_report
from fss_arm_calib.joint.settings import JointSettings
from fss_arm_calib.kinds import JOINT_SOURCES
from fss_arm_calib.messages import calibration_part, common_message
from fss_arm_calib.outcome import Outcome, parse_settings
from fss_arm_calib.segments.streams import Streams
from fss_arm_model.description import Arm
from fss_arm_msgs import msg
from fss_arm_ros.convert import to_time
from fss_arm_ros.rules import RESULT

AnyKind = Calibration[Any, Any]
JointOutcome = Outcome[SessionData, Solution]


def inputs(_: JointSettings, n: int) -> list[Input]:
    """Return the inputs: data and results of each other kind; results contain the deviations."""
    return [
        one for kind in JOINT_SOURCES.values() for one in (_data_input(kind), _result_input(kind))
    ]


def _data_input(kind: AnyKind) -> Input:
    def feed(gatherer: SessionCollector, message: Any) -> list[SessionData]:
        try:
            found = kind.data.from_message(message)
        except ValueError:
            gatherer.reject(f"invalid {kind.data.topic}")
            return []
        return gatherer.data(kind.name, found)

    return Input(kind.data.topic, kind.data.message, feed, latched=True, rule=kind.data.rule)


def _result_input(kind: AnyKind) -> Input:
    def feed(gatherer: SessionCollector, message: Any) -> list[SessionData]:
        found = calibration_part(message)
        parameters = found.provenance.parameters
        try:
            parse_settings(parameters, kind.settings)
        except (TypeError, ValueError):  # settings of another version
            gatherer.reject(f"invalid {kind.topic}")
            return []
        clocks = (check for check in found.checks if check.name == "clocks")
        back = max((c.value for c in clocks if c.value > c.threshold), default=0.0)
        return gatherer.result(kind.name, parameters, back)

    return Input(kind.topic, kind.message, feed, latched=True, rule=RESULT)


def calibrate_session(
    sessions: Sequence[SessionData], arm: Arm, s: JointSettings, streams: Streams, source: str
) -> JointOutcome:
    """Solve from the data of the nodes, each kind with the settings of its node."""
    one = sessions[-1] if sessions else SessionData()
    of_kinds = {name: kind.settings() for name, kind in JOINT_SOURCES.items()}
    for name, parameters in one.settings.items():
        of_kinds[name] = parse_settings(parameters, JOINT_SOURCES[name].settings)
    back = {name: {name: one.set_back.get(name, 0.0)} for name in JOINT_SOURCES}
    each = {name: replace(streams, set_back=jump) for name, jump in back.items()}
    outcome = calibrate([Session(source, one.data, each)], arm, s, JOINT_SOURCES, of_kinds, source)
    used = sessions[-1:] if outcome.used else ()
    origin = replace(outcome.provenance, begin=one.start, end=one.end)
    found: Any = replace(outcome, data=tuple(sessions), used=tuple(used), provenance=origin)
    return found


def to_message(outcome: JointOutcome, frame_id: str) -> msg.JointCalibration:
    """Convert the outcome to the message that is published."""
    message = msg.JointCalibration(calibration=common_message("joint", outcome, frame_id))
    if found := outcome.solution:
        own = list(found.session_parameters())
        message.sessions = [one.session for one in own]
        message.own = [one.name for one in own]
        message.own_units = [one.unit for one in own]
        message.own_values = [one.value for one in own]
        message.own_deviations = [one.deviation for one in own]
    return message


def session_message(sessions: Sequence[SessionData], frame_id: str) -> msg.CalibrationSession:
    """Convert the data of the nodes to the message that is published."""
    one = sessions[-1] if sessions else SessionData()
    message = msg.CalibrationSession(
        kinds=[*one.settings], settings=[*one.settings.values()], set_back=[*one.set_back.values()]
    )
    for name, kind in JOINT_SOURCES.items():
        setattr(message, _message_field(kind), kind.data.to_message(getattr(one, name), frame_id))
    message.header.frame_id, message.header.stamp = frame_id, to_time(one.end)
    return message


def sessions_from_message(message: msg.CalibrationSession) -> list[SessionData]:
    """Return the session in a message; an empty list if the message has no data of a node."""
    if not message.kinds:
        return []
    settings = dict(zip(message.kinds, message.settings, strict=True))
    set_back = dict(zip(message.kinds, map(float, message.set_back), strict=True))
    data: dict[str, Any] = {
        name: tuple(kind.data.from_message(getattr(message, _message_field(kind))))
        for name, kind in JOINT_SOURCES.items()
    }
    return [SessionData(**data, settings=settings, set_back=set_back)]


def _message_field(kind: AnyKind) -> str:
    return f"{kind.data.noun}s"


def data_counts(gatherer: SessionCollector) -> dict[str, object]:
    """Report the number of data of each kind."""
    data = gatherer.gathered.data
    return {_message_field(kind): len(data.get(name, ())) for name, kind in JOINT_SOURCES.items()}


def describe_clock_jump(outcome: JointOutcome, _: Streams) -> str:
    """Return a message if a clock jumped back at one of the nodes, else an empty string."""
    back = outcome.data[-1].set_back if outcome.data else {}
    services = [f"{name}/forget" for name, jump in back.items() if jump > 0.0]
    return f"a clock jumped back: call {', '.join(services)} to reset" if services else ""


def _summary(one: SessionData) -> str:
    return ", ".join(
        format_count(len(some), JOINT_SOURCES[name].data.noun) for name, some in one.data.items()
    )


JOINT = Calibration(
    name="joint",
    settings=JointSettings,
    data=Data(
        "session",
        "calibration/session",
        msg.CalibrationSession,
        SessionData,
        session_message,
        sessions_from_message,
        _summary,
        is_replaced=True,
    ),
    max_data=lambda _: 1,
    inputs=inputs,
    finder=lambda arm, _, kept: SessionCollector(arm.n, [*JOINT_SOURCES], kept),
    calibrate=calibrate_session,
    message=msg.JointCalibration,
    to_message=to_message,
    recomputed_fields=("own_values", "own_deviations"),
    report=joint_report,
    clocks=lambda streams, _: checks.clocks(streams, inf),  # no clock of its own: see `stale`
    stale=describe_clock_jump,
    health=data_counts,
    unavailable={
        "time offset": "already corrected in the data of each kind",
        "second session": "the nodes do not separate sessions; give from_bag --joint one bag per "
        "session, each with its own zeros, tilt and hose",
        "data of its own": "it uses the current data of kinematic, dynamic and drift",
    },
)
