"""A small motion-capture server: NatNet 3.0 over unicast UDP, as its SDK describes it.

A client asks at the command port for the server's description (message 0), then for the model
definitions (4); frames (7) go to the data port. Little-endian, strings end with a zero byte.
"""

import socket
import struct
import threading
from collections.abc import Mapping

from running import free_port

CONNECT, SERVER_INFO, REQUEST_MODELS, MODELS, FRAME = 0, 1, 4, 5, 7
RIGID_BODY = 1  # a model's type
TICKS = 1_000_000  # of the server's clock [1/s]

Pose = tuple[float, float, float, float, float, float, float]


def packet(message: int, payload: bytes) -> bytes:
    return struct.pack("<HH", message, len(payload)) + payload


def server_info(data_port: int) -> bytes:
    name = b"test server".ljust(256, b"\0")
    body = name + bytes([1, 0, 0, 0]) + bytes([3, 0, 0, 0])
    return packet(SERVER_INFO, body + struct.pack("<QH?4B", TICKS, data_port, False, 0, 0, 0, 0))


def models(names: list[str]) -> bytes:
    body = struct.pack("<i", len(names))
    for number, name in enumerate(names, 1):
        body += struct.pack("<i", RIGID_BODY) + name.encode() + b"\0"
        body += struct.pack("<ii3fi", number, -1, 0.0, 0.0, 0.0, 0)  # id, parent, offset, markers
    return packet(MODELS, body)


def frame(number: int, names: list[str], poses: Mapping[str, Pose]) -> bytes:
    """A frame; subjects without a pose are there, but not tracked."""
    body = struct.pack("<iiii", number, 0, 0, len(names))  # no marker sets, no other markers
    for identity, name in enumerate(names, 1):
        pose = poses.get(name, (0.0,) * 7)
        body += struct.pack("<i8fh", identity, *pose, 0.0, name in poses)
    body += struct.pack("<iiii", 0, 0, 0, 0)  # skeletons, labelled markers, force plates, devices
    body += struct.pack("<IIdQQQh", 0, 0, 0.01 * number, 0, 0, 0, 0) + bytes(4)
    return packet(FRAME, body)


class NatNetServer:
    """Answers one client after another, and sends it the frames it is told to."""

    def __init__(self, names: list[str], address: str = "127.0.0.1") -> None:
        self.names, self.address = names, address
        self.command = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.command.bind((address, 0))
        self.data_port = free_port()
        self.clients = 0  # that have asked for all
        self.number = 0
        threading.Thread(target=self.answer, daemon=True).start()

    @property
    def options(self) -> list[str]:
        return [f"port_command={self.command.getsockname()[1]}"]

    def answer(self) -> None:
        while True:
            try:
                data, client = self.command.recvfrom(1000)
            except OSError:
                return  # closed
            (message,) = struct.unpack_from("<H", data)
            if message == CONNECT:
                self.command.sendto(server_info(self.data_port), client)
            elif message == REQUEST_MODELS:
                self.command.sendto(models(self.names), client)
                self.clients += 1

    def send(self, poses: Mapping[str, Pose]) -> None:
        self.number += 1
        self.send_raw(frame(self.number, self.names, poses))

    def send_raw(self, data: bytes) -> None:
        self.command.sendto(data, (self.address, self.data_port))

    def close(self) -> None:
        self.command.close()
