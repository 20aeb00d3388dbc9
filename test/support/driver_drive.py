"""The driver's side of a serial line to a servo drive, with the firmware's simulated drive."""

import os
import select
import termios
import threading
import time

from firmware import Core, FirmwareLink, Joint

from fss_arm_driver import protocol
from fss_arm_driver.copley.link import DriveLink

STEP = 2000  # between two polls [us]


def exchange(core, data, baud, microseconds):
    """Send bytes to the drive at a rate; return its answers within that time."""
    answer = core.ask(f"line {data.hex() or '-'} {baud} {microseconds}")
    return bytes.fromhex(answer.removeprefix("-"))


class CopleyLink(FirmwareLink):
    """A link that the driver makes of a drive alone, for the tests of the firmware's link."""

    def __init__(self, core, boot=7, key=None, serial=0, baud=115_200):
        self.protocol, self.core, self.key, self.clock = protocol, core, key, 0
        self.baud = baud
        self.tell("drive")
        self.restart(boot)

    def restart(self, boot):
        self.link, self.answer = DriveLink(2, boot, self.key, self.baud), b""

    def send(self, frame):
        data = frame if isinstance(frame, bytes) else protocol.encode(frame, self.key)
        refused = self.link.state.gate.refused.total()
        self.link.receive(data, self.clock)
        return self.link.state.gate.refused.total() == refused

    def sent(self, request, microseconds, kind):
        frames, end = [], self.clock + microseconds
        while self.clock < end:
            step = min(STEP, end - self.clock)
            line, frame = self.link.poll(self.answer, self.clock)
            self.answer = exchange(self.core, line, self.link.drive.baud, step)
            self.clock += step
            frames += [protocol.decode(frame, self.key)] if frame else []
        return frames


class DriveOnPty(threading.Thread):
    """The drive behind one end of a pseudo-terminal, at the rate that the other has set."""

    def __init__(self, core: Core, end):
        super().__init__(daemon=True)
        self.core, self.end, self.closing = core, end, False
        self.lock = threading.Lock()
        self.ask("drive")
        self.start()

    def ask(self, request):
        with self.lock:
            return self.core.ask(request)

    def joint(self) -> Joint:
        position, velocity, mode, baud = self.ask("joint").split()
        return Joint(float(position), float(velocity), int(mode), int(baud))

    def run(self):
        before = time.monotonic_ns() // 1000
        while not self.closing:
            line = self.end.line
            try:
                ready = select.select([line], [], [], 0.002)[0]
                data = os.read(line.fileno(), 100) if ready else b""
                speed = termios.tcgetattr(line.fileno())[5]
                now = time.monotonic_ns() // 1000
                with self.lock:
                    baud = 9600 if speed == termios.B9600 else 115_200
                    answer = exchange(self.core, data, baud, now - before)
                before = now
                os.write(line.fileno(), answer)
            except (OSError, ValueError):  # unplugged, or no process has it open
                time.sleep(0.01)

    def close(self):
        self.closing = True
        self.join()
