"""The whole test bed, frame by frame: plant, sensors, and the electronics of the links.

Pure: time is what the caller lets pass, datagrams are bytes. One frame is one picture of VICON.
"""

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fss_arm_model.description import Arm
from fss_sim.electronics import LinkElectronics
from fss_sim.plant import Plant
from fss_sim.sensors import RATE, Noise, Sensors, Sight

FRAME = 1_000_000_000 // RATE  # [ns]
OUTAGE = RATE  # frames: how far time moves on while a testbed is not running
UPTIME = 10_000_000  # links were switched on within this time before the testbed [us]


class StateError(ValueError):
    """A file does not hold the state of this test bed."""


@dataclass(frozen=True)
class State:
    """What a test bed keeps when its power goes: where the bodies are, and what it has counted."""

    frame: int  # frames since the first begin
    boots: int  # starts of the links' electronics
    rests: int  # of the arm, each with its own error of the sensors
    q: tuple[float, ...]  # (3 + n)
    qd: tuple[float, ...]  # (3 + n)

    def save(self, path: Path) -> None:
        """Write it to a file, which at any time is whole."""
        part = path.with_name(path.name + ".part")
        part.write_text(json.dumps(asdict(self)) + "\n")
        os.replace(part, path)

    @classmethod
    def load(cls, path: Path, n: int) -> "State":
        """Read what `save` wrote for a test bed of n links.

        Raises:
            StateError: the file holds something else.
        """
        try:
            given = json.loads(path.read_text())
            numbers = {name: int(given[name]) for name in ("frame", "boots", "rests")}
            q, qd = (tuple(map(float, given[name])) for name in ("q", "qd"))
        except (ValueError, TypeError, KeyError) as error:
            raise StateError(f"{path} does not hold the state of a test bed: {error!r}") from None
        if not len(q) == len(qd) == 3 + n or not np.isfinite((q, qd)).all():
            raise StateError(
                f"{path} holds {len(q)} coordinates, expected {3 + n} finite ones for {n} links"
            )
        return cls(**numbers, q=q, qd=qd)

    def resumed(self) -> "State":
        """The state at the next start; its time lies after all that was ever reported."""
        return State(self.frame + OUTAGE, self.boots % 65535 + 1, self.rests, self.q, self.qd)


class Report(NamedTuple):
    """What comes out of one frame."""

    sight: Sight
    telemetry: Sequence[bytes | None]  # of each link, None between its frames


class Testbed:
    """A floating arm with its links' electronics and the sensors that look on.

    Args:
        arm: the true parameters.
        noise: of the sensors.
        seed: of the sensors' errors and the links' clocks.
        state: where to begin.
        rate: of the links' telemetry [frames/s].
        keys: by link, that frames are signed under.
    """

    def __init__(
        self,
        arm: Arm,
        noise: Noise,
        seed: int,
        state: State,
        rate: float = 5.0,
        keys: Mapping[int, bytes] | None = None,
    ) -> None:
        self.plant = Plant(arm, state.q, state.qd)
        self.sensors = Sensors(noise, seed, state.rests)
        keys = keys or {}
        self.links = [
            LinkElectronics(i, k, state.boots, rate, keys.get(i))
            for i, k in enumerate(arm.links, 1)
        ]
        self.frame, self._boots, self._begin = state.frame, state.boots, state.frame
        uptimes = np.random.default_rng((seed, state.boots)).integers(UPTIME, size=arm.n)
        self._uptimes: list[int] = uptimes.tolist()
        self._momentum = self.plant.momentum()

    def step(self) -> Report:
        """Let one frame's time pass."""
        for i, link in enumerate(self.links):
            self.plant.command(i, link.demand(self._clock(i), self.plant.motion(i)))
        self.plant.advance(1.0 / RATE)
        self.frame += 1
        plant = self.plant
        rate, qd = float(plant.qd[2]), plant.qd[3:]
        sight = self.sensors.look(self.frame, plant.base, plant.tip, rate, qd)
        telemetry = [k.telemetry(self._clock(i), plant.motion(i)) for i, k in enumerate(self.links)]
        return Report(sight, telemetry)

    def receive(self, link: int, data: bytes, late: int = 0) -> bool:
        """Hand a datagram to a link, counted from 0, `late` ns after the last frame.

        Returns:
            Whether the link took it: its sender is the one to send telemetry to.
        """
        return self.links[link].receive(data, self._clock(link) + late // 1000)

    def state(self) -> State:
        """What to save."""
        q, qd = (tuple(x.tolist()) for x in (self.plant.q, self.plant.qd))
        return State(self.frame, self._boots, self.sensors.rests, q, qd)

    def momentum_drift(self) -> float:
        """How much of the momentum was gained or lost since the start [kg m/s, kg m^2/s]."""
        return float(np.abs(self.plant.momentum() - self._momentum).max())

    def _clock(self, link: int) -> int:
        """A link's own clock at the last frame [us]."""
        return self._uptimes[link] + (self.frame - self._begin) * (FRAME // 1000)
