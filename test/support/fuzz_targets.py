"""Targets of the fuzzers: what reads bytes, goals and files of others, and what must hold.

A target takes any bytes. It may refuse them with its own named error; any other exception is a
finding.
"""

import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from types import SimpleNamespace

import base_board
import numpy as np
from builtin_interfaces.msg import Duration
from driver_frames import DISARM, MOVE, sealed
from driver_link import SAMPLE
from mcap.writer import CompressionType, Writer
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

from fss_arm_bags.reader import BagError, open_bags
from fss_arm_calib.segments.rests import Observation
from fss_arm_calib.state import restore
from fss_arm_driver import protocol as links
from fss_arm_driver.arm.move import MoveError
from fss_arm_driver.arm.move import check as reject_unsupported_fields
from fss_arm_driver.arm.move import plan as plan_move
from fss_arm_driver.arm.request import TrajectoryError, parse_request
from fss_arm_driver.arm.trajectory import plan_trajectory
from fss_arm_driver.session import LinkSession
from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import from_yaml, to_yaml
from fss_arm_model.files import ContentError
from fss_arm_motion.plan_file import parsed
from fss_arm_ros.state_file import StateError
from fss_base_driver import protocol as base
from fss_base_driver.dsp3000 import Lines
from fss_base_driver.protocol import BaseState
from fss_base_driver.session import BoardSession
from fss_base_driver.wrench import planar_wrench
from fss_gnc.bounds import check_duration, check_knot_times, check_poses, check_twists
from fss_link.protocol import FrameError, StreamDecoder, pack, parse_keys
from fss_link.session import CommandError
from fss_sim.faults import FaultError, read_script
from fss_sim.link.electronics import LinkElectronics
from fss_sim.plant.vehicle import Motion

ARM = paper_arm()
NUMBERS = struct.Struct("<d")


@dataclass(frozen=True)
class Target:
    """Function of bytes, with inputs to start from, and the errors by which it refuses others."""

    check: Callable[[bytes], object]
    seeds: Callable[[], list[bytes]]
    refusals: tuple[type[Exception], ...] = ()

    def __call__(self, data: bytes) -> None:
        with suppress(*self.refusals):
            self.check(data)


def frames(data: bytes) -> Iterator[tuple[bytes, int]]:
    """Yield frames with the time since the one before [us]; half of them sealed anew."""
    for at in range(0, len(data) - 3, 75):
        flags, time = struct.unpack_from("<BH", data, at)
        frame = data[at + 3 : at + 75].ljust(72, b"\0")
        yield (sealed(frame, None) if flags & 1 else frame), 100 * time


def numbers(data: bytes) -> list[float]:
    """Return the numbers of double precision in some bytes."""
    return [x for (x,) in NUMBERS.iter_unpack(data[: len(data) // 8 * 8])]


def packed(*values: float) -> bytes:
    return b"".join(NUMBERS.pack(value) for value in values)


def stamped(*given: bytes) -> list[bytes]:
    """Return sequences of frames, each 50 ms after the one before, to be sealed."""
    return [b"".join(struct.pack("<BH", 1, 500) + frame for frame in given), *given]


# --- decoders ------------------------------------------------------------------------------------


def decode_frame(protocol):
    def check(data):
        for frame, _ in frames(data):
            with suppress(FrameError):
                assert protocol.encode(protocol.decode(frame)) == frame

    return check


def split_stream(data):
    whole, parts, cut = StreamDecoder(), StreamDecoder(), data[0] if data else 0
    found = whole.feed(data)
    assert parts.feed(data[:cut]) + parts.feed(data[cut:]) == found
    assert all(len(frame) == 72 for frame in found)


def split_gyro(data):
    whole, parts, cut = Lines(), Lines(), data[0] if data else 0
    found = whole.feed(data)
    assert all(rate is None or abs(rate) < 7.0 for rate in found)
    if max(map(len, data.split(b"\n"))) < 64:
        assert parts.feed(data[:cut]) + parts.feed(data[cut:]) == found


def feed_session(make):
    """Telemetry at a driver's session: it stays able to command, and counts each frame."""

    def check(data):
        session, now, fed = make(), 1_700_000_000_000_000_000, 0
        for frame, later in frames(data):
            now, fed = now + 1000 * later, fed + 1
            session.feed(frame, now)
            assert session.counts["received"] == fed
            assert len(session.command(now)) == 72

    return check


def board_state(data):
    """Commands at a board: its valves are closed while it is not armed."""
    state, clock = base_board.board(), 1_000_000
    for frame, later in frames(data):
        clock += later
        state.receive(frame, clock)
        state.tick(clock)
        assert state.flags() & BaseState.ARMED or not state.valves()


def link_state(data):
    """Commands at a simulated link: each is taken or refused, and telemetry goes on."""
    link, clock = LinkElectronics(2, ARM.links[1], 7), 1_000_000
    rest = Motion(q=0.0, qd=0.0, current=0.0, torque=0.0)
    for frame, later in frames(data):
        clock += later
        link.receive(frame, clock)
        link.demand(clock, rest)
        assert len(link.telemetry(clock, rest) or bytes(72)) == 72


# --- goals ---------------------------------------------------------------------------------------


def check_move(data):
    given = numbers(data)
    q, (duration, keep_alive) = given[:-2], (0.0, 0.0, *given)[-2:]
    reject_unsupported_fields(ARM, q, duration, keep_alive)
    move = plan_move(ARM, (0.0,) * 4, tuple(q), duration)
    assert np.isfinite(move.duration)


def check_trajectory(data):
    names, at, points = 4, 0, []
    while len(data) - at >= 8:
        sec, nanosec = struct.unpack_from("<iI", data, at)
        counts = data[at + 7] % 5, data[at + 6] % 5
        values = numbers(data[at + 8 : at + 8 + 8 * sum(counts)])
        at += 8 + 8 * sum(counts)
        points.append(
            JointTrajectoryPoint(
                positions=values[: counts[0]],
                velocities=values[counts[0] :],
                time_from_start=Duration(sec=sec, nanosec=nanosec),
            )
        )
    message = JointTrajectory(joint_names=[f"joint_{i + 1}" for i in range(names)], points=points)
    request = parse_request(ARM, message)
    path = plan_trajectory(ARM, request, 0, lambda _: (np.zeros(4), np.zeros(4)))
    assert np.isfinite(path.at(path.end)[0]).all()


def check_bounds(data):
    given = numbers(data)
    check_duration("duration", given[0] if given else 0.0)
    k = len(given) // 7
    poses = check_poses("pose", given[k : 4 * k], (4.0, 4.0))
    check_twists("twist", given[4 * k : 7 * k])
    check_knot_times("time", given[:k], 0.01)
    assert np.isfinite(poses).all()


def check_wrench(data):
    given = (numbers(data) + 7 * [0.0])[:7]
    force, torque = (
        SimpleNamespace(**dict(zip("xyz", n, strict=True))) for n in (given[:3], given[3:6])
    )
    header = SimpleNamespace(frame_id="fss" if len(data) % 2 == 0 else data.decode("latin1"))
    message = SimpleNamespace(header=header, wrench=SimpleNamespace(force=force, torque=torque))
    assert np.abs(planar_wrench(message, "fss", 10.0)).max() <= 10.0


# --- files ---------------------------------------------------------------------------------------


def text(read):
    return lambda data: read(data.decode("utf-8", "replace"))


@cache
def folder():
    """Return a folder in memory that ends with the process."""
    return TemporaryDirectory(dir="/dev/shm" if Path("/dev/shm").is_dir() else None)


def read_file(read, suffix):
    def check(data):
        path = Path(folder().name, f"input{suffix}")
        path.write_bytes(data)
        read(path)

    return check


def read_bag(path):
    with open_bags(path) as bags:
        for _ in bags.messages():
            pass


def small_bag():
    path = Path(folder().name, "seed.mcap")
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=200, compression=CompressionType.NONE)
        writer.start(profile="ros2", library="other")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/robot_description", "cdr", schema)
        for k in range(3):
            writer.add_message(channel, k, b"\0\1\0\0\4\0\0\0arm\0", k)
        writer.finish()
    return path.read_bytes()


FAULTS = b"- {at: 20.0, part: link_2, fault: reset, duration: 0.5}\n"
POINT = struct.pack("<iI", 1, 0x04040000) + packed(*8 * [0.0])
LINK_FRAMES = [links.encode(frame) for frame in (DISARM, MOVE, SAMPLE)]
BASE_FRAMES = [base.encode(f) for f in (base_board.QUIET, base_board.GO, base_board.SAMPLE)]
PLAN = b"version: 1\nknots: {time: [0, 1], q: [[0], [1]], qd: [[0], [0]]}\n"
STATE = b'{"kind": "kinematic", "joints": 4, "data": [], "flags": {}}'
TARGETS = {
    "link_frame": Target(decode_frame(links), lambda: stamped(*LINK_FRAMES)),
    "base_frame": Target(decode_frame(base), lambda: stamped(*BASE_FRAMES)),
    "stream": Target(split_stream, lambda: [pack(frame) for frame in LINK_FRAMES]),
    "gyro_lines": Target(split_gyro, lambda: [b"\n-12.345678 1\n  1.000000 0\n"]),
    "link_session": Target(
        feed_session(lambda: LinkSession(1, ARM.links[0], 1.0, 2.0)), lambda: stamped(*LINK_FRAMES)
    ),
    "board_session": Target(
        feed_session(lambda: BoardSession(1.0, 2.0)), lambda: stamped(*BASE_FRAMES)
    ),
    "link_state": Target(link_state, lambda: stamped(*LINK_FRAMES)),
    "board_state": Target(board_state, lambda: stamped(*BASE_FRAMES)),
    "move": Target(check_move, lambda: [packed(*6 * [0.1])], (MoveError,)),
    "trajectory": Target(check_trajectory, lambda: [2 * POINT], (TrajectoryError,)),
    "base_goals": Target(check_bounds, lambda: [packed(*7 * [0.1])], (ValueError,)),
    "wrench": Target(check_wrench, lambda: [packed(0.1, 0.1, 0, 0, 0, 0.1)], (CommandError,)),
    "keys": Target(text(parse_keys), lambda: [b"1 " + 32 * b"0" + b" # one\n"], (ValueError,)),
    "description": Target(text(from_yaml), lambda: [to_yaml(ARM).encode()], (ContentError,)),
    "plan": Target(text(parsed), lambda: [PLAN], (ContentError,)),
    "fault_script": Target(text(read_script), lambda: [FAULTS], (FaultError,)),
    "state_file": Target(
        read_file(lambda path: restore(path, "kinematic", 4, Observation), ".json"),
        lambda: [STATE],
        (StateError,),
    ),
    "bag": Target(read_file(read_bag, ".mcap"), lambda: [small_bag()], (BagError,)),
}
