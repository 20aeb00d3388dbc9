"""SROS 2: what nodes do is what they may do; and under `Enforce` nobody else gets anywhere.

The second wants a middleware with DDS security, as the distribution's; the wheels' is without.
"""

import json
import os
import re
import subprocess
import sys
from fnmatch import fnmatch
from pathlib import Path

import pytest
from all_nodes import NODES
from rclpy.node import Node
from running import DOMAIN, OWN, run_command

from fss_policies import ACCESS, COMMON, topics
from fss_rehearsal.processes import Nodes

SCRIPTS = Path(__file__).resolve().parents[3] / "scripts"


@pytest.fixture(scope="module")
def nodes(tmp_path_factory):
    with Nodes(tmp_path_factory.mktemp("nodes"), print, OWN) as nodes:
        for name, (package, executable, given) in NODES.items():
            nodes.start(name, package, executable, **given)
        yield nodes


def done_by(watch, name):
    """The DDS topics that a node publishes on and hears, services' included."""
    told = {topic for topic, _ in watch.get_publisher_names_and_types_by_node(name, "/")}
    served = {name for name, _ in watch.get_service_names_and_types_by_node(name, "/")}
    called = {name for name, _ in watch.get_client_names_and_types_by_node(name, "/")}
    says = {f"rt{t}" for t in told} | {f"rr{s}Reply" for s in served}
    return says | {f"rq{c}Request" for c in called}


@pytest.mark.slow
def test_each_node_may_do_what_it_does_and_hardly_more(spin, nodes):
    watch = Node("watch")
    wanted = {name: " ".join(what[:2]) for name, what in NODES.items()}
    common = topics(COMMON)[0]

    def missing():
        if absent := wanted.keys() - set(watch.get_node_names()):
            return absent
        for name, what in wanted.items():
            did = done_by(watch, name)
            unused = [e for e in topics(ACCESS[what])[0] if e not in common and unmatched(e, did)]
            if unused := [e for e in unused if e not in OPTIONAL]:
                return {name: unused}
        return {}

    def unmatched(expression, did):
        return not any(fnmatch(topic, expression) for topic in did)

    found = [{}]
    spin(watch, lambda: not found.__setitem__(0, missing()) and not found[0], 240.0)
    for name, what in wanted.items():
        allowed = topics(COMMON | ACCESS[what])[0]
        stray = [t for t in done_by(watch, name) if not any(fnmatch(t, a) for a in allowed)]
        assert stray == [], name


#: What these do only when told to: transforms' prefix, time that is simulated, other names.
OPTIONAL = ("rt/vicon/*", "rt/clock", "rt/tf")


def run(*command, **env):
    """Run a command to its end, with further variables."""
    return run_command(*command, env=os.environ | env)


def keystore(folder, *lines):
    """A keystore for a configuration; its folder."""
    config = folder / "lab.sh"
    config.write_text("\n".join([f"export ROS_DOMAIN_ID={DOMAIN}", *lines]) + "\n")
    made = run(SCRIPTS / "fss_security.sh", folder / "keys", config, FSS_LOGS=str(folder))
    assert made.returncode == 0, made.stderr
    assert f"{len(lines) + 2} enclaves for domain {DOMAIN}" in made.stdout
    return folder / "keys"


def test_a_keystore_is_made_once_and_permissions_follow_the_nodes(tmp_path):
    lines = "node link_1 fss_arm_driver link", "FSS_NAMESPACE=fss2 node arm fss_arm_driver arm"
    keys = keystore(tmp_path, *lines)
    certificates = {f: f.read_bytes() for f in keys.rglob("*.pem")}
    assert keystore(tmp_path, *lines) == keys
    assert {f: f.read_bytes() for f in keys.rglob("*.pem")} == certificates
    link, arm = keys / "enclaves/lab/link_1", keys / "enclaves/lab/fss2/arm"
    assert "<topic>rt/joint_states</topic>" in (link / "permissions.xml").read_text()
    assert "<topic>rt/fss2/link_*/command</topic>" in (arm / "permissions.xml").read_text()
    ca = keys / "public/ca.cert.pem"
    for folder in (link, arm):
        for command in (
            ["verify", "-CAfile", ca, folder / "cert.pem"],
            ["smime", "-verify", "-text", "-CAfile", ca, "-in", folder / "permissions.p7s"],
            ["smime", "-verify", "-text", "-CAfile", ca, "-in", folder / "governance.p7s"],
        ):
            subprocess.run(["openssl", *command], check=True, capture_output=True)
    assert {f.stat().st_mode & 0o077 for f in keys.rglob("key.pem")} == {0}
    refused = run(SCRIPTS / "fss_security.sh", "/dev/null/keys")
    assert refused.returncode == 1
    assert re.fullmatch(r"fss_security.sh: .*Not a directory.*\n", refused.stderr)


SAY = """
import json, sys, time
import rclpy
from rclpy.node import Node
from std_msgs.msg import Empty
from fss_arm_msgs.msg import LinkCommand, LinkTelemetry
from fss_arm_ros.qos import SENSOR
rclpy.init(args=sys.argv)
node, heard, refused = Node("somebody"), [], []
node.create_subscription(LinkTelemetry, "link_1/telemetry", lambda m: heard.append(m.armed), SENSOR)
publishers = []
for kind, topic in ((Empty, "arm/stop"), (LinkCommand, "link_1/command")):
    try:
        publishers.append(node.create_publisher(kind, topic, 10))
    except Exception as error:
        refused.append(topic)
end = time.monotonic() + 6.0
while time.monotonic() < end:
    for publisher in publishers:
        publisher.publish(publisher.msg_type())
    rclpy.spin_once(node, timeout_sec=0.1)
topics = [t for t, _ in node.get_topic_names_and_types() if t == "/joint_states"]
print(json.dumps({"heard": len(heard), "armed": heard[-1:], "refused": refused, "topics": topics}))
"""


def said_by(enclave, env):
    """What becomes of a program that listens, stops and commands."""
    given = ["--ros-args", "--enclave", enclave] if enclave else []
    done = run(sys.executable, "-c", SAY, *given, **env)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_a_stranger_neither_commands_nor_stops_nor_reads(start, tmp_path):
    ports = OWN.ports(4)
    keys = keystore(
        tmp_path,
        "node bed fss_sim testbed",
        "node link_1 fss_arm_driver link",
        "node view fss_arm_view view",
    )
    secure = {
        "ROS_SECURITY_KEYSTORE": str(keys),
        "ROS_SECURITY_ENABLE": "true",
        "ROS_SECURITY_STRATEGY": "Enforce",
    }
    probe = "import rclpy, sys; rclpy.init(args=sys.argv); rclpy.create_node('probe')"
    arguments = "--ros-args", "--enclave", "/lab/link_1"
    probed = run(sys.executable, "-c", probe, *arguments, **secure)
    if "doesn't have the security libraries" in probed.stderr:
        pytest.skip("this middleware is built without DDS security")
    assert probed.returncode == 0, probed.stderr
    link = f"url:=udp://127.0.0.1:{ports[0]}?bind=0"
    for module, enclave, parameter in (
        ("fss_sim.testbed_node", "/lab/bed", f"ports:={ports}"),
        ("fss_arm_driver.link_node", "/lab/link_1", link),
    ):
        start(module, "--ros-args", "--enclave", enclave, "-p", parameter, **secure)
    person = secure | {"ROS_SECURITY_ENCLAVE_OVERRIDE": "/person"}

    armed = run(sys.executable, "-c", ARM, **person)
    assert armed.returncode == 0, armed.stdout + armed.stderr

    nothing = {"heard": 0, "armed": [], "refused": [], "topics": []}
    assert said_by("", {"ROS_SECURITY_ENABLE": "false"}) == nothing
    view = said_by("/lab/view", secure)
    assert view["heard"] > 5
    assert view["armed"] == [True]  # whoever may only listen has not stopped it either
    assert view["refused"] == ["arm/stop", "link_1/command"]
    stopped = run(sys.executable, SCRIPTS / "fss_arm.py", "stop", **person)
    assert stopped.stdout.startswith("link_1: stopped after "), stopped.stderr


ARM = """
import rclpy, sys, time
from rclpy.node import Node
from std_srvs.srv import SetBool
rclpy.init(args=sys.argv)
node = Node("person")
client, end = node.create_client(SetBool, "link_1/arm"), time.monotonic() + 40.0
while time.monotonic() < end:
    if client.wait_for_service(5.0):
        future = client.call_async(SetBool.Request(data=True))
        rclpy.spin_until_future_complete(node, future, timeout_sec=5.0)
        if future.done() and future.result().success:
            sys.exit(0)
sys.exit("not armed")
"""
