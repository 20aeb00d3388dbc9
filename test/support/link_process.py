"""A link as a process of its own: emulated electronics on a UDP port, and a log of what it did.

usage: link_process.py HOST PORT LOG. Lines of the log, in the computer's time [ns]:
    measured SEQUENCE TIME POSITION
    taken SEQUENCE TIME FLAGS LEFT      LEFT: from then to the command's expiry [us]
    state TIME ARMED WATCHDOG SPEED
"""

import socket
import sys
import time
from contextlib import suppress
from select import select

from fss_arm_driver.protocol import Telemetry, decode
from fss_arm_model.description import paper_arm
from fss_sim.link.electronics import LinkElectronics
from fss_sim.plant.plant import Motion

DRIFT = 40e-6
STEP = 0.002  # [s]


def main():
    host, port = sys.argv[1], int(sys.argv[2])
    with open(sys.argv[3], "w", buffering=1) as log:
        run(host, port, log)


def run(host, port, log):
    link = LinkElectronics(1, paper_arm().links[0], boot=5)
    born = time.time_ns() - 10**10
    port_of_link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    port_of_link.bind((host, port))
    peer, motion, then, state = None, Motion(0.0, 0.0, 0.0, 0.0), time.time_ns(), None

    def clock():
        return round((time.time_ns() - born) * (1.0 + DRIFT)) // 1000

    while True:
        if select([port_of_link], [], [], STEP)[0]:
            data, source = port_of_link.recvfrom(2000)
            if link.receive(data, clock()):
                peer, command = source, link.gate.command
                left = command.expiry - link.gate.arrival
                print("taken", command.sequence, time.time_ns(), command.flags, left, file=log)
        demand = link.demand(clock(), motion)
        now = time.time_ns()
        motion = turned(motion, demand, (now - then) * 1e-9)
        then = now
        if (link.armed, link.watchdog_tripped, motion.qd) != state:
            state = link.armed, link.watchdog_tripped, motion.qd
            print("state", now, *map(float, state), file=log)
        measured = time.time_ns()
        if data := link.telemetry(clock(), motion):
            frame = decode(data)
            assert isinstance(frame, Telemetry)
            print("measured", frame.sequence, measured, frame.position, file=log)
            if peer:
                with suppress(OSError):  # the cable is pulled
                    port_of_link.sendto(data, peer)


def turned(motion, demand, seconds):
    """The joint goes to where it shall be as fast as it may."""
    way = max(-demand.speed * seconds, min(demand.set_point - motion.q, demand.speed * seconds))
    moving = demand.mode and demand.speed and abs(way) > 0.0
    q = motion.q + way if moving else motion.q
    return Motion(q, way / seconds if moving else 0.0, 0.0, 0.0)


if __name__ == "__main__":
    main()
