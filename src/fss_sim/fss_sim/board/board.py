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
from fss_sim.link.power import BROWN_OUT_VOLTAGE, RECOVERY_VOLTAGE, Battery, Power
from fss_sim.link.radio import Station
from fss_sim.noise import Noise
from fss_sim.plant.vehicle import Vehicle

# It is switched on at most this long before the test bed starts [us].
MAX_INITIAL_UPTIME = 10_000_000
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
        self._regulator_on = True  # True if the regulator can work; it also needs a charged battery
        self._drift = Random(f"{seed}, board").gauss(0.0, noise.clock_drift)
        random = Random(f"{seed}, board, {run}")
        self.uptime = random.randrange(MAX_INITIAL_UPTIME)  # when the test bed starts [us]
        self._in, self._out = (Channel(Random(random.random()), station) for _ in range(2))
        self._peer: Any = None  # receiver of the telemetry
        # Board clock [us] and simulation time [ns] at the start.
        self._clock_at_start = self._started_at = 0
        self.state: BoardState | None = None  # None while it is off

    @property
    def rejected(self) -> int:
        """Number of datagrams rejected since its start."""
        return self.state.gate.refused.total() if self.state else 0

    @property
    def running(self) -> bool:
        """Return True if the board is switched on."""
        return self.state is not None

    def has_power(self, faults: LinkFaults) -> bool:
        """Return True if the board has power and is not held in reset."""
        powered = bool(self._regulator_on and self.battery.charge)
        return powered and not (faults.dead or faults.reset)

    def _draw_current(self, plant: Vehicle, seconds: float, faults: LinkFaults) -> None:
        """Draw the current of board and valves from the battery for a time [s]."""
        if faults.dead or not self.battery.charge:
            return
        current = self._power.base + self._power.valve * sum(plant.valves)
        self.battery.draw(current, 0.0, seconds, faults.resistance)
        threshold = BROWN_OUT_VOLTAGE if self._regulator_on else RECOVERY_VOLTAGE
        self._regulator_on = self.battery.volts > threshold

    def clock(self, now: int) -> int:
        """Return the time of the board's own clock [us]."""
        return self._clock_at_start + round((now - self._started_at) * (1.0 + self._drift) / 1000)

    def start(self, boot: int, now: int, uptime: int = 0) -> None:
        """Switch the board on, as if `uptime` us ago."""
        self.state = BoardState(board_gate(boot, self._key))
        self._clock_at_start, self._started_at, self._peer = uptime, now, None
        self._last_period = -1  # periods of the clock until the last frame
        self._sequence = self._gyro_sum = self._gyro_samples = 0
        self._broken = 0  # valves that were found to draw no current, as Slow.FAULTS
        self._closing_times = CLOSED  # commanded closing times of the valves, by the clock

    def stop(self) -> None:
        """Switch the board off."""
        self.state = None

    def receive(self, data: bytes, peer: Any, now: int, faults: LinkFaults = NO_FAULTS) -> None:
        """Receive a datagram through the channel, subject to its faults."""
        self._in.send(Datagram(data, peer), now, faults)
        self._process_arrivals(now)

    def apply_commands(self, now: int, plant: Vehicle) -> None:
        """Apply the received commands to valves and gripper."""
        self._process_arrivals(now)
        if self.state is None:
            if plant.thrusters.pulse_commanded:  # without current the valves close
                plant.thrust(CLOSED)
            return
        self.state.tick(self.clock(now))
        if self.state.until != self._closing_times:
            self._closing_times = self.state.until
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
        self._draw_current(plant, seconds, faults)
        if self.state and rate is not None:
            self._gyro_sum += round(rate / GYRO_SCALE)
            self._gyro_samples += 1
        clock = self.clock(now)
        if self.state and clock // self._period != self._last_period:
            self._last_period = clock // self._period
            self.state.tick(clock)
            self._broken |= self.state.valves() & plant.thrusters.broken
            measured = Measured(
                self._gyro_sum,
                self._gyro_samples,
                plant.closed,
                plant.holds,
                self._slow_fields(plant),
            )
            frame = self.state.telemetry(clock, self._sequence, measured)
            self._sequence += 1
            self._out.send(Datagram(encode(frame, self._key), self._peer), now, faults)
        return self._out.arrived(now)

    def _slow_fields(self, plant: Vehicle) -> dict[BaseSlow, int]:
        tank, propulsion = plant.thrusters.pressure, plant.thrusters.propulsion
        return {
            BaseSlow.TANK: round(1e-3 * tank),
            BaseSlow.SUPPLY: round(min(tank, propulsion.regulator_pressure) / SUPPLY_UNIT),
            BaseSlow.BATTERY: round(10.0 * self.battery.volts),
            BaseSlow.TEMPERATURE: round(10.0 * (propulsion.temperature - 273.15)),
            BaseSlow.FIRMWARE: FIRMWARE,
            BaseSlow.FAULTS: self._broken,
        }

    def _process_arrivals(self, now: int) -> None:
        for datagram in self._in.arrived(now):
            if self.state and self.state.receive(datagram.data, self.clock(now)):
                self._peer = datagram.peer
