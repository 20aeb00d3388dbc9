"""Joint estimate from all rests, maneuvers and drifts of one or more bags: `from_bag --joint`."""

from collections.abc import Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

from fss_arm_bags.reader import describe_source, open_bags
from fss_arm_calib.bag_data import find_data, topic_name
from fss_arm_calib.calibration import Input
from fss_arm_calib.joint.calibrate import Session, Solution, calibrate
from fss_arm_calib.joint.settings import JointSettings
from fss_arm_calib.kinds import JOINT_SOURCES
from fss_arm_calib.outcome import Outcome
from fss_arm_model.description import Arm
from fss_arm_model.description_file import described
from fss_arm_model.files import ContentError, read_yaml
from fss_arm_ros.command_line import default_settings


def kind_settings(path: str | None, namespace: str) -> dict[str, Any]:
    """Return the settings of each kind of calibration, overridden by a ROS parameter file.

    Raises:
        ValueError: the file has other content, or a setting is impossible.
    """
    given: Any = read_yaml(Path(path)) if path else {}
    if not isinstance(given, dict) or not all(isinstance(one, dict) for one in given.values()):
        raise ContentError(f"{path}: it", given, f"settings of {', '.join(JOINT_SOURCES)}")
    found = {}
    for kind in JOINT_SOURCES.values():
        known = default_settings(kind.settings, namespace)
        for name in (f"/**/{kind.name}", kind.name):
            section = given.get(name, {})
            for key, value in section.get("ros__parameters", section).items():
                if key not in known:
                    raise ContentError(f"{path}: {name}", key, "a setting of it")
                known[key] = tuple(value) if isinstance(value, list) else value
        found[kind.name] = kind.settings(**known)
    return found


def read_session(
    path: str, arm: Arm, settings: Mapping[str, Any], namespace: str
) -> tuple[Session, str]:
    """Return the data in a bag of all kinds whose topics it has, and the name of its source.

    Raises:
        BagError: the bag cannot be read, lacks the topics of all kinds, or has one of a wrong type.
    """
    data, streams, missing = {}, {}, list[Input]()
    with open_bags(path) as bags:
        for kind in JOINT_SOURCES.values():
            s = settings[kind.name]
            inputs = kind.inputs(s, arm.n)
            names = {topic_name(bags, one, namespace, needed=False): one for one in inputs}
            there = [one for name, one in names.items() if name in bags.topics]
            if lacking := [one for one in inputs if one.needed and one not in there]:
                missing += lacking
                continue
            finder = kind.finder(arm, s, [])
            data[kind.name] = find_data(bags, finder, there, s.horizon, namespace)
            streams[kind.name] = finder.streams()
        if not data:
            topic_name(bags, missing[0], namespace)
        return Session(Path(path).name, data, streams), describe_source(bags)


def estimate_from_bags(
    bags: Sequence[str], s: JointSettings, params: str | None, namespace: str
) -> Outcome[Any, Solution]:
    """Estimate from the data of all bags, each a session."""
    arm, settings = described(s.arm), kind_settings(params, namespace)
    read = [read_session(bag, arm, settings, namespace) for bag in bags]
    read.sort(key=lambda one: min((d.start for d in chain(*one[0].data.values())), default=0))
    sources = ", ".join(source for _, source in read)
    return calibrate([one for one, _ in read], arm, s, JOINT_SOURCES, settings, sources)
