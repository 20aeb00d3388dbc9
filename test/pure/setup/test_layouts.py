"""Layouts of other programs: each topic and field that they name is there, and of that type."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

from fss_arm_bags.definitions import message_class

ROOT = Path(__file__).resolve().parents[3]
LAYOUTS = ROOT / "config/layouts"
TYPES = {
    "rviz_default_plugins/RobotModel": "std_msgs/msg/String",
    "rviz_default_plugins/Pose": "geometry_msgs/msg/PoseStamped",
    "rviz_default_plugins/MarkerArray": "visualization_msgs/msg/MarkerArray",
}


def topics():
    """The type of each topic, by the documentation's table."""
    found = {}
    for line in (ROOT / "docs/reference/topics.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) > 2 and re.fullmatch(r"`(?:\w+/(?:msg/)?)?\w+`.*", cells[1]):
            package, _, name = cells[1].split("`")[1].rpartition("/")
            package = package.removesuffix("/msg") or "fss_arm_msgs"
            for topic in re.findall(r"`([^`]+)`", cells[0]):
                found[f"/{topic.strip('/')}"] = f"{package}/msg/{name}"
    return found


def field_of(kind, path):
    """The type of a field, by a path such as predicted[2]; a bound index is within its array."""
    for part in re.split(r"[./]", path):
        name, _, index = part.partition("[")
        text = message_class(kind).get_fields_and_field_types()[name]
        bound = re.search(r"\[(\d+)\]$", text)
        assert bool(index) == (bool(bound) or text.startswith("sequence<")), part
        assert not (index and bound) or int(index.rstrip("]")) < int(bound[1]), part
        kind = re.sub(r"\[\d+\]$|^sequence<|>$", "", text).replace("/", "/msg/")
    return kind


def curves():
    """What PlotJuggler and Foxglove plot: topic and field; PlotJuggler names joints."""
    page = ElementTree.parse(LAYOUTS / "plotjuggler.xml")
    names = [curve.attrib["name"] for curve in page.iter("curve")]
    panels = json.loads((LAYOUTS / "foxglove.json").read_text())["configById"].values()
    values = [path["value"] for panel in panels for path in panel.get("paths", [])]
    joints = [re.sub(r"/joint_(\d)/(\w+)$", r"/\2[\1]", name) for name in names]
    return [tuple(n.rsplit("/", 1)) for n in joints] + [tuple(v.split(".", 1)) for v in values]


@pytest.mark.parametrize(("topic", "path"), curves())
def test_what_is_plotted_is_a_number_of_a_message(topic, path):
    assert field_of(topics()[topic], path) in ("double", "float")


def test_both_plot_the_same():
    half = len(curves()) // 2
    assert [topic for topic, _ in curves()[:half]] == [topic for topic, _ in curves()[half:]]
    assert half > 10


def test_displays_are_of_topics_that_are_there():
    displays = yaml.safe_load((LAYOUTS / "fss_arm.rviz").read_text())["Visualization Manager"]
    shown = []
    for display in displays["Displays"]:
        topic = display.get("Topic") or display.get("Description Topic")
        if topic:
            shown.append(topic["Value"])
            assert topics()[topic["Value"]] == TYPES[display["Class"]]
    assert len(shown) == 4
    panels = json.loads((LAYOUTS / "foxglove.json").read_text())["configById"]
    for topic in panels["3D!arm"]["topics"]:
        assert topic in topics()


def test_each_panel_has_a_place():
    page = json.loads((LAYOUTS / "foxglove.json").read_text())

    def placed(part):
        return [part] if isinstance(part, str) else placed(part["first"]) + placed(part["second"])

    assert sorted(placed(page["layout"])) == sorted(page["configById"])
