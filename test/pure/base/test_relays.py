"""Messages of common receivers, as poses in metres by subject."""

import re
import sys
from types import ModuleType, SimpleNamespace

import pytest
from geometry_msgs.msg import PoseStamped, TransformStamped

from fss_base_driver.mocap.relays import READERS, RelayError, message_type, named_poses

ARRAY = "motion_capture_tracking_interfaces/msg/NamedPoseArray"
POSITION = "vicon_receiver/msg/Position"


@pytest.fixture
def install(monkeypatch):
    """install(type): a class of that full name, as of an installed package."""

    def made(name):
        package, _, kind = name.partition("/msg/")
        module = ModuleType(f"{package}.msg")
        found = type(kind, (SimpleNamespace,), {"__module__": f"{package}.msg._{kind.lower()}"})
        setattr(module, kind, found)
        monkeypatch.setitem(sys.modules, package, ModuleType(package))
        monkeypatch.setitem(sys.modules, f"{package}.msg", module)
        return found

    return made


def test_poses_are_read_by_the_full_name_of_their_type(install):
    array, position = install(ARRAY), install(POSITION)
    assert message_type(["std_msgs/msg/Empty", ARRAY], "") is array
    pose = PoseStamped().pose
    pose.position.x = 1500.0
    poses = [SimpleNamespace(name=name, pose=pose) for name in ("fss", "tip")]
    at = 1.5, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0
    assert [*named_poses(array(poses=poses), "", 1e-3)] == [("fss", at), ("tip", at)]
    message = position(
        subject_name="fss", x_trans=1500.0, y_trans=0, z_trans=0, x_rot=0, y_rot=0, z_rot=0, w=1
    )
    assert [*named_poses(message, "", 1.0)] == [("fss", at)]
    assert [*named_poses(message, "base", 1.0)] == [("base", at)]
    tip = TransformStamped(child_frame_id="tip")
    assert [name for name, _ in named_poses(tip, "", 1.0)] == ["tip"]


@pytest.mark.parametrize(
    ("name", "subject", "reason"),
    [
        ("other_msgs/msg/Position", "", "other_msgs/msg/Position contains no poses, expected one "),
        (POSITION, "", f"{POSITION} is published, but its package is not installed"),
        (ARRAY, "fss", f"{ARRAY} names its subjects: write the topic without fss="),
    ],
)
def test_what_cannot_be_relayed_is_refused(name, subject, reason):
    with pytest.raises(RelayError, match=re.escape(reason)) as caught:
        message_type([name], subject)
    if "expected" in reason:
        assert all(known in str(caught.value) for known in READERS)
