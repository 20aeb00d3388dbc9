"""Link of the test bed: its electronics while they have power, and the channels to its driver."""

from random import Random
from typing import Any

from fss_arm_model import description
from fss_sim.faults import NO_DRIVE_FAULTS, NO_FAULTS, DriveFaults, LinkFaults
from fss_sim.link import instruments
from fss_sim.link.channel import Channel, Datagram
from fss_sim.link.electronics import LinkElectronics
from fss_sim.link.power import Power, Supply
from fss_sim.link.radio import Station
from fss_sim.link.servo import OFF, ServoDrive
from fss_sim.noise import Noise
from fss_sim.plant.plant import Demand, Motion

UPTIME = 10_000_000  # a link is switched on at most this long before the test bed starts [us]


class Link:
    """One link, stepped with every frame; times are simulation times [ns].

    Args:
        number: number of the link; 1 is next to the base.
        link: description of the link.
        noise: errors of its instruments and its clock.
        seed: seed of these errors; a resumed run has the same errors.
        run: seed of the random numbers that must differ when a run is resumed.
        rate: telemetry rate [frames/s].
        key: key that signs the frames, if any.
        torque_rate: samples of the torque converter per second.
        charge: charge of the battery, 0 to 1.
        power: parameters of its battery and of the loads on it.
        station: radio station for its datagrams; None: a wire of its own.
    """

    def __init__(
        self,
        number: int,
        link: description.Link,
        noise: Noise,
        seed: int,
        run: int,
        rate: float = 5.0,
        key: bytes | None = None,
        torque_rate: int = 80,
        charge: float = 1.0,
        power: Power | None = None,
        station: Station | None = None,
    ) -> None:
        self.number = number
        self._link, self._rate, self._key = link, rate, key
        made = Random(f"{seed}, {number}")
        self._drift = made.gauss(0.0, noise.clock_drift)
        more = Random(f"{seed}, {number}, laboratory")
        self.instruments = instruments.make(link.torque_sensor, noise, made, torque_rate, more)
        self.supply = Supply(power, charge)
        self.drive = ServoDrive(link, self.instruments.encoder)
        ways = Random(f"{seed}, {number}, {run}")
        self.uptime = ways.randrange(UPTIME)  # when the test bed starts [us]
        self._in, self._out = (Channel(Random(ways.random()), station) for _ in range(2))
        self._peer: Any = None  # receiver of the telemetry
        self._since = self._began = 0  # link clock [us] and simulation time [ns] at the start
        self.electronics: LinkElectronics | None = None

    @property
    def refused(self) -> int:
        """Number of datagrams rejected since its start."""
        return self.electronics.gate.refused.total() if self.electronics else 0

    @property
    def running(self) -> bool:
        """Return True if the electronics are switched on."""
        return self.electronics is not None

    def has_power(self, faults: LinkFaults) -> bool:
        """Return True if the electronics have power and are not held in reset."""
        return self.supply.runs and not (faults.dead or faults.reset)

    def clock(self, now: int) -> int:
        """Return the time of the link's own clock [us]."""
        return self._since + round((now - self._began) * (1.0 + self._drift) / 1000)

    def start(self, boot: int, now: int, uptime: int = 0) -> None:
        """Switch the electronics on, as if `uptime` us ago."""
        self.electronics = LinkElectronics(
            self.number,
            self._link,
            boot,
            self._rate,
            self._key,
            self.instruments,
            self.drive,
            self.supply.battery,
        )
        self._since, self._began, self._peer = uptime, now, None

    def stop(self) -> None:
        """Switch the electronics off."""
        self.electronics = None

    def put(self, data: bytes, peer: Any, now: int, faults: LinkFaults = NO_FAULTS) -> None:
        """Send a datagram to the link."""
        self._in.put(Datagram(data, peer), now, faults)
        self._listen(now)

    def demand(self, now: int, motion: Motion) -> Demand:
        """Return the demand on its joint from now on."""
        self._listen(now)
        if self.electronics:
            self.electronics.demand(self.clock(now), motion)
        else:
            self.drive.go_on(motion)
        return self.drive.effort(motion)

    def report(
        self,
        now: int,
        motion: Motion,
        seconds: float,
        faults: LinkFaults = NO_FAULTS,
        drive: DriveFaults = NO_DRIVE_FAULTS,
    ) -> list[Datagram]:
        """Advance by `seconds`; return the telemetry that has arrived at its driver."""
        if self.drive.demand.mode == OFF:  # even if a hand moves the joint
            motion = motion._replace(current=0.0)
        load = None if faults.dead else self.drive.load(motion)
        self.supply.advance(load, seconds, faults.resistance)
        self.drive.advance(seconds, motion, self.supply.volts, drive)
        if self.electronics:
            frame = self.electronics.telemetry(self.clock(now), motion)
            if frame:
                self._out.put(Datagram(frame, self._peer), now, faults)
        return self._out.arrived(now)

    def _listen(self, now: int) -> None:
        for datagram in self._in.arrived(now):
            if self.electronics and self.electronics.receive(datagram.data, self.clock(now)):
                self._peer = datagram.peer
