"""A servo drive as far as docs/start/hardware.md knows it, for the tests of the driver's side."""

import os
import select
import termios
import threading
import time

READ_ONLY = {0x0C, 0x18, 0x1E, 0x20, 0x32, 0xA0, 0xC9}
TURN = 0.02  # [s]
RATES = {9600: termios.B9600, 115200: termios.B115200}


class FakeDrive:
    """Answers lines; turns at once to where it shall be, or as fast as it shall turn."""

    def __init__(self):
        self.lines, self.error, self.mute = [], 0, False
        self.reported, self.shakes = 0, False  # more status bits; never measured at rest
        self.switch_on()
        self.referenced = True

    def switch_on(self):
        """Power-up: at 9600 baud, off, without reference, with the bit that says so."""
        self.baud, self.buffer, self.reset = 9600, b"", True
        self.referenced, self.moving = False, 0
        self.held = {0x02: 0, 0x24: 0, 0x2F: 0, 0x36: 1000, 0x37: 1000, 0x90: 9600, 0xA4: 0}
        self.held |= {0xC8: 0, 0xCA: 0, 0xCB: 0, 0xCC: 0, 0xCD: 0, 0xCF: 30000}
        self.position = self.velocity = self.current = 0
        self.rest = 0.0  # of a count, turned already

    def feed(self, data, baud):
        """What it answers to bytes that come at a rate."""
        if data and baud != self.baud:
            if baud < self.baud:  # so long a low level is a break
                self.baud, self.buffer = 9600, b""
            return b""
        *lines, self.buffer = (self.buffer + data).split(b"\r")
        answers = [self.hear(line.decode(errors="replace")) for line in lines]
        return b"".join(answer.encode() + b"\r" for answer in answers if answer and not self.mute)

    def hear(self, line):
        self.lines.append(line)
        try:
            return self.answer(line)
        except ValueError:
            return "e 33"

    def answer(self, line):
        if self.error and line[:1] in ("s", "t"):
            error, self.error = self.error, 0
            return f"e {error}"
        match line.split():
            case []:
                return "e 3"
            case ["g", name]:
                return self.get(int(name[1:], 16))
            case ["s", name, number]:
                return self.set(int(name[1:], 16), int(number))
            case ["t", number]:
                return self.trajectory(int(number))
            case ["r"]:
                self.switch_on()
                return ""
        return "e 33"

    def get(self, variable):
        computed = {
            0x0C: self.current,
            0x18: self.velocity + 5000 * self.shakes,
            0x1E: 240,
            0x20: 31,
            0x32: self.position,
            0xA0: self.status(),
            0xC9: self.referenced << 12 | bool(self.moving) << 15,
        }
        number = computed.get(variable, self.held.get(variable))
        return "e 9" if number is None else f"v {number}"

    def status(self):
        faulty = bool(self.held[0xA4])
        off = self.held[0x24] == 0
        return (
            off << 12 | self.reset << 20 | faulty << 22 | bool(self.velocity) << 27 | self.reported
        )

    def set(self, variable, number):
        if variable in READ_ONLY:
            return "e 11"
        if variable not in self.held:
            return "e 9"
        self.held[variable] = number if variable != 0xA4 else self.held[0xA4] & ~number
        if variable == 0x90:
            self.baud = number
        mode = self.held[0x24]
        self.velocity = self.held[0x2F] if mode == 11 else 0 if mode == 0 else self.velocity
        self.current = self.held[0x02] if mode == 1 else 0
        return "ok"

    def trajectory(self, order):
        if self.held[0x24] != 21:
            return "e 31"
        if order == 0:
            self.moving = self.velocity = 0
        if order == 1:
            self.moving = 3
        if order == 2:
            self.referenced, self.position = True, 0
        return "ok"

    def turn(self):
        """Let 20 ms pass: a move takes three such turns, whatever its way."""
        if self.moving:
            self.moving -= 1
            self.position += (self.held[0xCA] - self.position) // (self.moving + 1)
            self.velocity = self.held[0xCB] if self.moving else 0
        elif self.held[0x24] == 11:
            self.rest += 0.1 * self.velocity * TURN
            self.position += int(self.rest)
            self.rest -= int(self.rest)
        elif self.held[0x24] == 21:
            self.velocity = 0


class DriveOnPty(threading.Thread):
    """The drive behind one end of a pseudo-terminal, at the rate that the other has set."""

    def __init__(self, end):
        super().__init__(daemon=True)
        self.drive, self.end, self.closing = FakeDrive(), end, False
        self.start()

    def run(self):
        turned = time.monotonic()
        while not self.closing:
            if time.monotonic() - turned > 0.02:
                self.drive.turn()
                turned = time.monotonic()
            line = self.end.line
            try:
                if not select.select([line], [], [], 0.02)[0]:
                    continue
                data = os.read(line.fileno(), 100)
                speed = termios.tcgetattr(line.fileno())[5]
                for byte in data:
                    baud = 9600 if speed == termios.B9600 else 115200
                    if answer := self.drive.feed(bytes([byte]), baud):
                        os.write(line.fileno(), answer)
            except (OSError, ValueError):  # unplugged, or nobody has it open
                time.sleep(0.01)

    def close(self):
        self.closing = True
        self.join()
