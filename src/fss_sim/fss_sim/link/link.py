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
from fss_sim.link.servo import MODE_OFF, ServoDrive
from fss_sim.noise import Noise
from fss_sim.plant.vehicle import Demand, Motion

# A link is switched on at most this long before the test bed starts [us].
MAX_INITIAL_UPTIME = 10_000_000


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
        build_random = Random(f"{seed}, {number}")
        self._drift = build_random.gauss(0.0, noise.clock_drift)
        laboratory_random = Random(f"{seed}, {number}, laboratory")
        self.instruments = instruments.make_instruments(
            link.torque_sensor, noise, build_random, torque_rate, laboratory_random
        )
        self.supply = Supply(power, charge)
        self.drive = ServoDrive(link, self.instruments.encoder)
        run_random = Random(f"{seed}, {number}, {run}")
        self.uptime = run_random.randrange(MAX_INITIAL_UPTIME)  # when the test bed starts [us]
        self._in, self._out = (Channel(Random(run_random.random()), station) for _ in range(2))
        self._peer: Any = None  # receiver of the telemetry
        # Link clock [us] and simulation time [ns] at the start.
        self._clock_at_start = self._started_at = 0
        self.electronics: LinkElectronics | None = None

    @property
    def rejected(self) -> int:
        """Number of datagrams rejected since its start."""
        return self.electronics.gate.refused.total() if self.electronics else 0

    @property
    def running(self) -> bool:
        """Return True if the electronics are switched on."""
        return self.electronics is not None

    def has_power(self, faults: LinkFaults) -> bool:
        """Return True if the electronics have power and are not held in reset."""
        return self.supply.regulator_on and not (faults.dead or faults.reset)

    def clock(self, now: int) -> int:
        """Return the time of the link's own clock [us]."""
        return self._clock_at_start + round((now - self._started_at) * (1.0 + self._drift) / 1000)

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
        self._clock_at_start, self._started_at, self._peer = uptime, now, None

    def stop(self) -> None:
        """Switch the electronics off."""
        self.electronics = None

    def receive(self, data: bytes, peer: Any, now: int, faults: LinkFaults = NO_FAULTS) -> None:
        """Receive a datagram through the channel, subject to its faults."""
        self._in.send(Datagram(data, peer), now, faults)
        self._process_arrivals(now)

    def demand(self, now: int, motion: Motion) -> Demand:
        """Return the demand on its joint from now on."""
        self._process_arrivals(now)
        if self.electronics:
            self.electronics.demand(self.clock(now), motion)
        else:
            self.drive.repeat_demand(motion)
        return self.drive.effective_demand(motion)

    def report(
        self,
        now: int,
        motion: Motion,
        seconds: float,
        faults: LinkFaults = NO_FAULTS,
        drive: DriveFaults = NO_DRIVE_FAULTS,
    ) -> list[Datagram]:
        """Advance by `seconds`; return the telemetry that has arrived at its driver."""
        if self.drive.demand.mode == MODE_OFF:  # even if a hand moves the joint
            motion = motion._replace(current=0.0)
        load = None if faults.dead else self.drive.load(motion)
        self.supply.advance(load, seconds, faults.resistance)
        self.drive.advance(seconds, motion, self.supply.volts, drive)
        if self.electronics:
            frame = self.electronics.telemetry(self.clock(now), motion)
            if frame:
                self._out.send(Datagram(frame, self._peer), now, faults)
        return self._out.arrived(now)

    def _process_arrivals(self, now: int) -> None:
        for datagram in self._in.arrived(now):
            if self.electronics and self.electronics.receive(datagram.data, self.clock(now)):
                self._peer = datagram.peer
