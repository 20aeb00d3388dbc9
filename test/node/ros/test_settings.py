"""Parameters from a dataclass, and how a node ends."""

from dataclasses import dataclass

import pytest
from rclpy.node import Node
from rclpy.parameter import Parameter

from fss_arm_model.settings import NOT_NEGATIVE, POSITIVE, SettingError, Settings, between, setting
from fss_arm_model.vehicle import Vehicle
from fss_arm_ros.parameters import declare
from fss_arm_ros.program import Program


@dataclass(frozen=True)
class Thing(Settings):
    rate: float = setting(2.0, "how often", unit="Hz", check=POSITIVE)
    count: int = setting(3, "how many", check=between(0, 9))
    name: str = setting("", "what it is called")
    on: bool = setting(False, "whether it is")
    names: tuple[str, ...] = setting((), "what they are called")
    gains: tuple[float, ...] = setting((1.0,), "how strong", check=NOT_NEGATIVE)


class ThingNode(Node):
    """Is a thing."""

    def __init__(self, **options):
        super().__init__("thing", **options)
        self.thing = declare(self, Thing)
        self.create_timer(0.01, self.end)

    def end(self):
        raise SystemExit(self.thing.name or self.thing.count)


def declared(**values):
    node = Node("thing", parameter_overrides=[Parameter(k, value=v) for k, v in values.items()])
    try:
        return declare(node, Thing)
    finally:
        node.destroy_node()


def test_defaults_and_values_come_back_typed(ros):
    assert declared() == Thing()
    got = declared(rate=5, names=["a", "b"], gains=[1, 2], on=True, count=4, name="x")
    assert got == Thing(5.0, 4, "x", True, ("a", "b"), (1.0, 2.0))
    assert type(got.rate) is float
    assert [type(gain) for gain in got.gains] == [float, float]


def test_of_what_a_file_gives_to_all_nodes_each_takes_its_own(ros, monkeypatch, tmp_path):
    shared = "/**: {ros__parameters: {rate: 7, arm: my_arm.yaml, valve_1: {stuck: 1.0}}}\n"
    own = "/thing: {ros__parameters: {%s: 5}}\n"

    def read(text):
        (tmp_path / "shared.yaml").write_text(text)
        arguments = ["--ros-args", "--params-file", str(tmp_path / "shared.yaml")]
        monkeypatch.setattr("sys.argv", ["thing", *arguments])
        node = Node("thing", cli_args=arguments)
        try:
            return declare(node, Thing)
        finally:
            node.destroy_node()

    assert read(shared + own % "count") == Thing(rate=7.0, count=5)
    with pytest.raises(SettingError, match=r"no parameter cuont; is it count\?"):
        read(shared + own % "cuont")


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"rate": "x"}, "rate is 'x', expected a number"),
        ({"rate": True}, "rate is True, expected a number"),
        ({"count": 1.5}, "count is 1.5, expected an integer"),
        ({"on": 1}, "on is 1, expected true or false"),
        ({"name": 12}, "name is 12, expected a string"),
        ({"names": "a"}, "names is 'a', expected a list"),
        ({"names": [1]}, "names is 1, expected a string"),
        ({"raet": 1.0}, r"no parameter raet; is it rate\?"),
        ({"speed": 1.0}, "no parameter speed; there are rate, count"),
        ({"count": 10}, "count is 10, expected 0 to 9"),
        ({"gains": [1.0, -1.0]}, "gains is -1.0, expected 0 or more"),
        ({"rate": -1.0}, "rate is -1.0 Hz, expected a positive number"),
    ],
)
def test_wrong_values_are_named(ros, values, said):
    with pytest.raises(ValueError, match=said):
        declared(**values)


def test_the_description_is_shown_and_the_value_is_fixed(ros):
    node = Node("thing")
    declare(node, Thing)
    rate, count, name = map(node.describe_parameter, ("rate", "count", "name"))
    assert rate.description == "how often [Hz]; a positive number"
    assert not rate.floating_point_range  # it has no largest value
    assert [(r.from_value, r.to_value) for r in count.integer_range] == [(0, 9)]
    assert not name.floating_point_range
    assert not node.set_parameters([Parameter("rate", value=3.0)])[0].successful
    node.destroy_node()


@pytest.mark.parametrize(
    ("namespace", "topic", "prefix"),
    [
        ("", "vicon/fss/fss", ""),
        ("/fss2", "/vicon/fss2/fss2", "fss2/"),
        ("/lab/fss2", "/vicon/fss2/fss2", "lab/fss2/"),
    ],
)
def test_defaults_tell_vehicles_apart(ros, namespace, topic, prefix):
    node = Node("thing", namespace=namespace)
    got = declare(node, Vehicle)
    assert (got.base_topic, got.frame_prefix) == (topic, prefix)
    assert got.base_frame == f"{prefix}fss"
    about = node.describe_parameter("base_frame").description
    assert about.endswith("default in a namespace /NAME: NAME/fss")
    node.destroy_node()
    given = [Parameter("base_frame", value="base"), Parameter("frame_prefix", value="")]
    node = Node("thing", namespace=namespace, parameter_overrides=given)
    got = declare(node, Vehicle)
    assert (got.base_frame, got.frame_prefix) == ("base", "")
    node.destroy_node()


@pytest.mark.parametrize(
    ("args", "code", "said"),
    [
        ("--help", 0, "rate (default 2.0)"),
        ("", 3, ""),
        ("--ros-args -p count:=0", 0, ""),
        ("--ros-args -p name:=why", 1, "thing: why"),
        ("--ros-args -p rate:=-1", 1, "thing: rate is -1.0 Hz, expected a positive number"),
        ("--ros-args -p rate:=[]", 1, "thing: rate is None, expected a number"),
        ("--ros-args -p names:=[] -p count:=0", 0, ""),
        ("--ros-args -p rate", 2, "thing: '-p rate' is not understood, expected -p NAME"),
        ("--ros-args --no-such", 2, "thing: ['--no-such'] is not understood after --ros-args"),
        ("rate:=1", 2, "'rate:=1' is not understood; give it as --ros-args -p rate:=1"),
        ("-p rate:=1", 2, "'-p' is not understood; give it after --ros-args: --ros-args -p ..."),
        ("lunch", 2, "thing: 'lunch' is not understood; try --help"),
        ("--ros-args -p rate=1", 2, "'-p rate=1' is not understood, expected -p NAME:=VALUE"),
        ("--ros-args -r a", 2, "'-r a' is not understood, expected -r NAME:=NEW_NAME"),
    ],
)
def test_every_end_has_its_exit_code_and_at_most_one_line(capfd, args, code, said):
    thing = Program(f"{__name__}:ThingNode", f"{__name__}:Thing")
    assert thing(["/some/where/thing", *args.split()]) == code
    out, err = capfd.readouterr()
    assert said in out + err
    assert len(err.splitlines()) <= 1
