"""Board of the base: its state machine, its measurements, and the channels to its driver."""

from random import Random
from typing import Any

from fss_base_driver.protocol import (
    VALVES,
    BaseSlow,
    BoardState,
    Gripper,
    Measured,
    board_gate,
    encode,
)
from fss_sim.faults import NO_FAULTS, LinkFaults
from fss_sim.link.channel import Channel, Datagram
from fss_sim.link.power import BROWN_OUT, REVIVAL, Battery, Power
from fss_sim.link.radio import Station
from fss_sim.noise import Noise
from fss_sim.plant.plant import Vehicle

UPTIME = 10_000_000  # it is switched on at most this long before the test bed starts [us]
GYRO_SCALE = 1e-6  # rate of one count of the gyro's samples [rad/s]
SUPPLY_UNIT = 100.0  # [Pa]
FIRMWARE = 0x010000  # 1.0.0
BATTERIES = 2  # in parallel, each like that of a link
CLOSED = VALVES * (0,)


class Board:
    """Board of one base, stepped with every frame; times are simulation times [ns].

    Args:
        noise: errors of its clock.
        seed: seed of these errors; a resumed run has the same errors.
        run: seed of the random numbers that must differ when a run is resumed.
        rate: telemetry rate [frames/s].
        key: key that signs the frames, if any.
        charge: charge of the batteries, 0 to 1.
        power: parameters of batteries and loads.
        station: radio station for its datagrams; None: a wire of its own.
    """

    def __init__(
        self,
        noise: Noise,
        seed: int,
        run: int,
        rate: float = 20.0,
        key: bytes | None = None,
        charge: float = 1.0,
        power: Power | None = None,
        station: Station | None = None,
    ) -> None:
        self._period, self._key = round(1e6 / rate), key
        self._power = p = power or Power()
        self.battery = Battery(BATTERIES * p.energy, p.resistance / BATTERIES, charge)
        self._runs = True  # True if the regulator can work; it also needs a charged battery
        self._drift = Random(f"{seed}, board").gauss(0.0, noise.clock_drift)
        ways = Random(f"{seed}, board, {run}")
        self.uptime = ways.randrange(UPTIME)  # when the test bed starts [us]
        self._in, self._out = (Channel(Random(ways.random()), station) for _ in range(2))
        self._peer: Any = None  # receiver of the telemetry
        self._since = self._began = 0  # board clock [us] and simulation time [ns] at the start
        self.state: BoardState | None = None  # None while it is off

    @property
    def refused(self) -> int:
        """Number of datagrams rejected since its start."""
        return self.state.gate.refused.total() if self.state else 0

    @property
    def running(self) -> bool:
        """Return True if the board is switched on."""
        return self.state is not None

    def has_power(self, faults: LinkFaults) -> bool:
        """Return True if the board has power and is not held in reset."""
        return bool(self._runs and self.battery.charge) and not (faults.dead or faults.reset)

    def _draw(self, plant: Vehicle, seconds: float, faults: LinkFaults) -> None:
        """Draw the current of board and valves from the battery for a time [s]."""
        if faults.dead or not self.battery.charge:
            return
        current = self._power.base + self._power.valve * sum(plant.valves)
        self.battery.draw(current, 0.0, seconds, faults.resistance)
        self._runs = self.battery.volts > (BROWN_OUT if self._runs else REVIVAL)

    def clock(self, now: int) -> int:
        """Return the time of the board's own clock [us]."""
        return self._since + round((now - self._began) * (1.0 + self._drift) / 1000)

    def start(self, boot: int, now: int, uptime: int = 0) -> None:
        """Switch the board on, as if `uptime` us ago."""
        self.state = BoardState(board_gate(boot, self._key))
        self._since, self._began, self._peer = uptime, now, None
        self._periods = -1  # periods of the clock until the last frame
        self._sequence = self._sum = self._samples = 0
        self._broken = 0  # valves that were found to draw no current, as Slow.FAULTS
        self._until = CLOSED  # commanded closing times of the valves, by the clock

    def stop(self) -> None:
        """Switch the board off."""
        self.state = None

    def put(self, data: bytes, peer: Any, now: int, faults: LinkFaults = NO_FAULTS) -> None:
        """Send a datagram to the board."""
        self._in.put(Datagram(data, peer), now, faults)
        self._listen(now)

    def act(self, now: int, plant: Vehicle) -> None:
        """Command valves and gripper as received."""
        self._listen(now)
        if self.state is None:
            if plant.thrusters.driven:  # without current the valves close
                plant.thrust(CLOSED)
            return
        self.state.tick(self.clock(now))
        if self.state.until != self._until:
            self._until = self.state.until
            plant.thrust([1e-6 * left for left in self.state.remaining()])
        if self.state.gripper is not Gripper.KEEP:
            plant.closed = self.state.gripper is Gripper.CLOSE

    def report(
        self,
        now: int,
        plant: Vehicle,
        rate: float | None,
        seconds: float,
        faults: LinkFaults = NO_FAULTS,
    ) -> list[Datagram]:
        """Advance by `seconds`; return the telemetry that has arrived at its driver.

        `rate` is a sample of the gyro, if there is one [rad/s].
        """
        self._draw(plant, seconds, faults)
        if self.state and rate is not None:
            self._sum, self._samples = self._sum + round(rate / GYRO_SCALE), self._samples + 1
        clock = self.clock(now)
        if self.state and clock // self._period != self._periods:
            self._periods = clock // self._period
            self.state.tick(clock)
            self._broken |= self.state.valves() & plant.thrusters.broken
            measured = Measured(
                self._sum, self._samples, plant.closed, plant.holds, self._slow(plant)
            )
            frame = self.state.telemetry(clock, self._sequence, measured)
            self._sequence += 1
            self._out.put(Datagram(encode(frame, self._key), self._peer), now, faults)
        return self._out.arrived(now)

    def _slow(self, plant: Vehicle) -> dict[BaseSlow, int]:
        tank, propulsion = plant.thrusters.pressure, plant.thrusters.propulsion
        return {
            BaseSlow.TANK: round(1e-3 * tank),
            BaseSlow.SUPPLY: round(min(tank, propulsion.regulator_pressure) / SUPPLY_UNIT),
            BaseSlow.BATTERY: round(10.0 * self.battery.volts),
            BaseSlow.TEMPERATURE: round(10.0 * (propulsion.temperature - 273.15)),
            BaseSlow.FIRMWARE: FIRMWARE,
            BaseSlow.FAULTS: self._broken,
        }

    def _listen(self, now: int) -> None:
        for datagram in self._in.arrived(now):
            if self.state and self.state.receive(datagram.data, self.clock(now)):
                self._peer = datagram.peer
