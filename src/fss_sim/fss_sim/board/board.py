"""The base's board: its table of states, what its instruments read, and the ways to its driver."""

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

UPTIME = 10_000_000  # it was switched on within this time before the test bed [us]
GYRO_SCALE = 1e-6  # of a count of the gyro's samples [rad/s]
SUPPLY_UNIT = 100.0  # [Pa]
FIRMWARE = 0x010000  # 1.0.0
BATTERIES = 2  # side by side, each as a link's
CLOSED = VALVES * (0,)


class Board:
    """One board, stepped with every frame; times are the simulation's [ns].

    Args:
        noise: of its clock.
        seed: of that, whatever has been going on before.
        run: seed of what must not repeat itself when a run is resumed.
        rate: of telemetry [frames/s].
        key: that frames are signed under, if any.
        charge: of the batteries, 0 to 1.
        power: what they are like, and what lives on them.
        station: on the air, through which its datagrams go; None: a wire of its own.
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
        self._runs = True  # the regulator, while there is charge
        self._drift = Random(f"{seed}, board").gauss(0.0, noise.clock_drift)
        ways = Random(f"{seed}, board, {run}")
        self.uptime = ways.randrange(UPTIME)  # when the test bed begins [us]
        self._in, self._out = (Channel(Random(ways.random()), station) for _ in range(2))
        self._peer: Any = None  # whom telemetry goes to
        self._since = self._began = 0  # the clock's time then [us], and the simulation's
        self.state: BoardState | None = None  # while it has power

    @property
    def refused(self) -> int:
        """Datagrams refused since its start."""
        return self.state.gate.refused.total() if self.state else 0

    @property
    def running(self) -> bool:
        """Whether it is switched on."""
        return self.state is not None

    def has_power(self, faults: LinkFaults) -> bool:
        """Whether it can run."""
        return bool(self._runs and self.battery.charge) and not (faults.dead or faults.reset)

    def _draw(self, plant: Vehicle, seconds: float, faults: LinkFaults) -> None:
        """Live on the battery for a time [s]."""
        if faults.dead or not self.battery.charge:
            return
        current = self._power.base + self._power.valve * sum(plant.valves)
        self.battery.draw(current, 0.0, seconds, faults.resistance)
        self._runs = self.battery.volts > (BROWN_OUT if self._runs else REVIVAL)

    def clock(self, now: int) -> int:
        """Its own clock [us]."""
        return self._since + round((now - self._began) * (1.0 + self._drift) / 1000)

    def start(self, boot: int, now: int, uptime: int = 0) -> None:
        """Switch it on, `uptime` us ago."""
        self.state = BoardState(board_gate(boot, self._key))
        self._since, self._began, self._peer = uptime, now, None
        self._periods = -1  # of the clock, at the last frame
        self._sequence = self._sum = self._samples = 0
        self._broken = 0  # valves that were seen to draw no current, as Slow.FAULTS
        self._until = CLOSED  # what the valves were told, by the clock

    def stop(self) -> None:
        """Stop it."""
        self.state = None

    def put(self, data: bytes, peer: Any, now: int, faults: LinkFaults = NO_FAULTS) -> None:
        """Send it a datagram."""
        self._in.put(Datagram(data, peer), now, faults)
        self._listen(now)

    def act(self, now: int, plant: Vehicle) -> None:
        """Have valves and gripper do what they are told from now on."""
        self._listen(now)
        if self.state is None:
            if plant.thrusters.driven:  # without current they close
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
        """What arrives of its telemetry, `seconds` after the last time it was asked.

        `rate`: by the gyro, if that answers [rad/s].
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
