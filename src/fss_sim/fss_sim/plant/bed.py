"""Dynamics of everything that floats on the table: vehicles, targets, grips and contacts.

Between contacts each chain moves independently, many steps in one call. The number of steps
without any contact is estimated from gaps and speeds, and checked afterwards. Impulses at the start
of a step are needed if it would otherwise end with overlapping parts, or if arms hold each other.
They are chosen so that at the end of the step

    parts   gap >= 0, by contact.py's law of impact
    grips   the pose of one gripper relative to the other is unchanged

Parts that lean on each other, or pull, therefore touch at the end of each step, as constraints hold
in SHAKE (Ryckaert, Ciccotti & Berendsen 1977). Both chains receive their impulse at the same point,
which conserves momentum. The work of the impulses enters the energy audit.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.held import Approach, Target, approach
from fss_arm_model.integration import STEP
from fss_arm_model.kernels import Floats
from fss_arm_model.kinematics import tip_jacobian, tip_pose
from fss_sim.plant.contact import FEATURES, GAP, Contact, Scene
from fss_sim.plant.impact import TOUCH, Impact
from fss_sim.plant.target import Passive, caught
from fss_sim.plant.weld import Weld

if TYPE_CHECKING:
    from fss_sim.plant.plant import Vehicle

REACH = 5e-3  # parts can touch in one step within this gap plus their motion in two steps [m]
ALREADY = -2e-4  # parts that overlap by more at first pass through each other until apart [m]
AMPLE = 10  # no check afterwards if the time to a possible contact is this multiple of the advance
MOST = 8  # largest number of trials of a step
TIP = Target(fixture=(0.0, 0.0, 0.0))  # a gripper, as a target that another gripper can hold
FAR = Approach(np.inf, 0.0, 0.0)


class Audit(NamedTuple):
    """Audit of momentum and energy: present amount minus amount supplied is constant."""

    momentum: Floats  # linear, x and y [N s], and angular about the world's origin [N m s]
    energy: float  # kinetic, and of the gears' springs [J]
    impulse: Floats  # (3,) external since the start, including what propellant carries away
    work: float  # of all forces since the start, including contacts and captures [J]
    contact: float = 0.0  # part of `work` by contacts and captures; it only decreases [J]

    @property
    def balance(self) -> Floats:
        """Momentum minus impulse, and energy minus work: constant, (4,)."""
        return np.append(self.momentum - self.impulse, self.energy - self.work)


class Clearance(NamedTuple):
    """Gap between two parts."""

    one: str
    other: str
    gap: float  # below 0 if they overlap [m]


class Bed:
    """Table with the vehicles and targets that float on it.

    Args:
        vehicles: vehicles in their initial state.
        targets: targets in their initial state.
        contact: law of contact; None: bodies pass through each other.
        tolerance: tolerance of the error control; 0: fixed steps.
    """

    def __init__(
        self,
        vehicles: Sequence["Vehicle"],
        targets: Sequence[Passive] = (),
        contact: Contact | None = None,
        tolerance: float = 0.0,
    ) -> None:
        self.vehicles, self.targets = list(vehicles), list(targets)
        self.contact, self.tolerance, self.step = contact, tolerance, 0
        self.touched: dict[tuple[str, str], float] = {}  # impulses in the last `advance` [N s]
        self._welds: list[Weld] = []
        self._lost = 0.0  # energy change by contacts and captures [J]
        for vehicle in self.vehicles:
            vehicle.bed = self
        self._arrange()
        self._pass(0)
        self._begin = self.audit.balance

    def advance(self, seconds: float) -> None:
        """Advance the simulation by a time, in whole steps of the drives."""
        for vehicle in self.vehicles:
            self._use_gripper(vehicle)
        begin, steps = self.step, round(seconds / STEP)
        self.touched = {}
        while self.step < begin + steps:
            self._go_on(begin + steps - self.step)
        for vehicle in self.vehicles:
            vehicle.spend(begin, steps)

    @property
    def audit(self) -> Audit:
        """Momentum and energy audit of all bodies at present."""
        has, given = np.sum([chain.books for chain in self._chains], axis=0)
        work = float(given[3]) + self._lost
        return Audit(has[:3], float(has[3]), given[:3], work, self._lost)

    @property
    def imbalance(self) -> Floats:
        """Error of the audit since the start, (4,) [N s, N s, N m s, J]."""
        return self.audit.balance - self._begin

    def clearances(self) -> list[Clearance]:
        """Return the gap of each pair of parts that can touch, and of each vehicle to the edge."""
        found = [
            Clearance(*names, gap)
            for names, gap in zip(self._scene.names, self._room()[:, 0].tolist(), strict=True)
        ]
        for vehicle in self.vehicles:
            name, gap = vehicle.name or "vehicle", vehicle.edge_clearance
            found.append(Clearance(name, "table edge", gap))
        return found

    def nearest(self) -> Clearance:
        """Return the pair of parts with the least gap; the gap is infinite if there is no pair."""
        gaps = self._room()[:, 0]
        if not gaps.size:
            return Clearance("", "", np.inf)
        least = int(np.argmin(gaps))
        return Clearance(*self._scene.names[least], float(gaps[least]))

    def within_reach(self, vehicle: "Vehicle") -> "tuple[Vehicle | Passive | None, Approach]":
        """Return the thing that the vehicle holds, or else the nearest to its gripper.

        The second value is the approach to it: distance, angle and speed.
        """
        found: list[tuple[Vehicle | Passive, Approach]] = []
        things: list[Vehicle | Passive] = [*self.targets, *self.vehicles]
        for thing in things if vehicle.n else ():
            if isinstance(thing, Passive):
                seen = approach(vehicle.p, vehicle.q, vehicle.qd, thing.target, thing.state)
            elif thing is vehicle or not thing.n:
                continue
            else:
                twist = tip_jacobian(thing.p, thing.q) @ thing.qd
                tip = np.array([tip_pose(thing.p, thing.q), twist])
                seen = approach(vehicle.p, vehicle.q, vehicle.qd, TIP, tip)
            if thing is vehicle.held:
                return thing, seen
            found.append((thing, seen))
        return min(found, key=lambda one: one[1].distance, default=(None, FAR))

    # Grips

    def _use_gripper(self, vehicle: "Vehicle") -> None:
        """Move the fingers as commanded; to close, they wait until a fixture is within reach."""
        fingers, gripper = vehicle.fingers, vehicle.world.gripper
        if not vehicle.closed:
            fingers.since, fingers.missed = None, False
            if vehicle.held:
                self._release(vehicle)
            return
        if vehicle.held or fingers.missed:
            return
        thing, seen = self.within_reach(vehicle)
        takes = gripper.takes(seen)
        if fingers.since is None and takes:
            fingers.since = self.step
        if fingers.since is None or self.step - fingers.since < round(gripper.closing_time / STEP):
            return
        if takes and thing:
            self._grip(vehicle, thing)
        else:
            fingers.missed = True

    def _grip(self, vehicle: "Vehicle", thing: "Vehicle | Passive") -> None:
        """Grip a thing: momentum is conserved, and the energy lost enters the audit."""
        vehicle.held = thing
        if isinstance(thing, Passive) and thing.holder is None:
            had, given = vehicle.books + thing.books
            vehicle.take(thing, caught(vehicle.p, vehicle.q, vehicle.qd, vehicle.inertia(), thing))
            vehicle.books[1] = given
            self._lost += vehicle.books[0, 3] - had[3]
        else:
            one = thing.holder if isinstance(thing, Passive) else thing
            assert one is not None
            if not any({w.one, w.other} == {one, vehicle} for w in self._welds):
                self._welds.append(Weld(one, vehicle))
                self._arrange()
                self._stop_past_each_other()
        self._arrange()

    def _stop_past_each_other(self) -> None:
        """Stop the relative motion of arms that hold each other by an impulse, as a grip closes."""
        impact = self._impact(self._scene.pairs[:0])
        self._kick(impact.change())
        self._pass(0)
        self._lost += impact.gained()

    def _release(self, vehicle: "Vehicle") -> None:
        """Release the thing held; another vehicle that holds the target keeps it."""
        thing, vehicle.held = vehicle.held, None
        others = [one for one in self.vehicles if one.held is thing]
        if isinstance(thing, Passive) and thing.holder is vehicle:
            vehicle.drop(thing)
            self._welds = [w for w in self._welds if w.one is not vehicle or w.other not in others]
            self._arrange()
            for other in others:
                self._grip(other, thing)
            return
        keeps = isinstance(thing, Passive) or thing is None or thing.held is not vehicle
        one = thing.holder if isinstance(thing, Passive) else thing
        if keeps:
            self._welds = [w for w in self._welds if {w.one, w.other} != {one, vehicle}]
        self._arrange()

    def _overloaded(self, vehicle: "Vehicle", before: Floats | None, time: float) -> bool:
        """Return True if the grip transmitted more force or torque than the fingers can hold.

        `before` is the twist, `time` [s] ago, of a target that is part of the vehicle's last link.
        """
        gripper, target = vehicle.world.gripper, vehicle.held
        force, torque = 0j, 0.0
        tip = complex(*tip_pose(vehicle.p, vehicle.q)[:2])
        if isinstance(target, Passive) and target.holder is vehicle and before is not None:
            (x, y, _), after = target.state
            gained = (after - before) / time * target.masses
            force = complex(gained[0], gained[1])
            torque = gained[2] + (np.conj(complex(x, y) - tip) * force).imag
        for weld in self._welds:
            if vehicle in (weld.one, weld.other) and (weld.other is vehicle or vehicle.held):
                sign = 1.0 if weld.other is vehicle else -1.0
                given = sign * weld.impulse / STEP
                at = complex(*tip_pose(weld.other.p, weld.other.q)[:2])
                force += complex(given[0], given[1])
                torque += given[2] + (np.conj(at - tip) * complex(given[0], given[1])).imag
        return (0.0 < gripper.force < abs(force)) or (0.0 < gripper.torque < abs(torque))

    # Motion

    def _arrange(self) -> None:
        """Determine the chains that move independently, and the pairs of parts that can touch."""
        free = [target for target in self.targets if target.holder is None]
        self._chains: list[Vehicle | Passive] = [*self.vehicles, *free]
        number = {id(chain): c for c, chain in enumerate(self._chains)}
        rigid = {frozenset((number[id(w.one)], number[id(w.other)])) for w in self._welds}
        parts = [chain.parts() for chain in self._chains]
        self._scene = Scene([chain.p for chain in self._chains], parts, rigid)
        self._past = self._room()[:, 0] < ALREADY

    def _room(self) -> Floats:
        """Return each pair's gap [m], and an upper bound of its closing speed [m/s], (g, 2)."""
        return self._scene.room(*self._moving())

    def _moving(self) -> tuple[Floats, Floats]:
        q = np.concatenate([chain.q for chain in self._chains])
        return q, np.concatenate([chain.qd for chain in self._chains])

    def _impact(self, pairs: Floats) -> Impact:
        """Return the impulse problem of a step in which these pairs can touch."""
        (q, v), slices = self._moving(), self._scene.slices
        inverse = np.zeros((v.size, v.size))
        for chain, part in zip(self._chains, slices, strict=True):
            inverse[part, part] = np.linalg.inv(chain.inertia())
        part_of = {id(chain): part for chain, part in zip(self._chains, slices, strict=True)}
        welds = [(w, part_of[id(w.one)], part_of[id(w.other)]) for w in self._welds]
        return Impact(self.contact or Contact(), self._scene, pairs, q, v, inverse, welds)

    def _pass(self, steps: int) -> None:
        for chain in self._chains:
            chain.go(steps, self.step, self.tolerance)

    def _restore(self, kept: Sequence[tuple[Floats, ...]]) -> None:
        for chain, its in zip(self._chains, kept, strict=True):
            chain.kept = its

    def _kick(self, change: Floats) -> None:
        for chain, part in zip(self._chains, self._scene.slices, strict=True):
            chain.kick(change[part])

    def _go_on(self, most: int) -> None:
        """Advance by at most `most` steps; release grips that were overloaded."""
        loaded = [v for v in self.vehicles if v.held and v.world.gripper.limited]
        before = [v.held.state[1] if isinstance(v.held, Passive) else None for v in loaded]
        count = self._steps(most)
        self.step += count
        for vehicle, twist in zip(loaded, before, strict=True):
            if vehicle.held and self._overloaded(vehicle, twist, count * STEP):
                vehicle.fingers.missed = True
                self._release(vehicle)

    def _steps(self, most: int) -> int:
        """Advance by steps without contact, or by one step; return their number."""
        if not (self._welds or (self.contact and self._scene.names)):
            self._pass(most)
            return most
        room = self._room()
        self._past &= room[:, 0] < 0.0
        watched = room[~self._past] if self.contact else room[:0]
        slack = (watched[:, 0] / (1.5 * watched[:, 1] + 0.05)).min(initial=np.inf) / STEP
        count = 1 if self._welds else int(min(max(slack, 1.0), most))
        kept = [chain.kept for chain in self._chains]
        while count > 1:
            self._pass(count)
            if slack >= AMPLE * count:
                return count
            after = self._room()[~self._past]
            way = STEP * count * np.maximum(watched[:, 1], after[:, 1])
            if (watched[:, 0] + after[:, 0] > way).all():
                return count
            self._restore(kept)
            count //= 2
        near = ~self._past & (room[:, 0] < REACH + 2.0 * STEP * room[:, 1])
        self._meet(kept, near if self.contact else np.zeros_like(near))
        return 1

    def _meet(self, kept: Sequence[tuple[Floats, ...]], near: npt.NDArray[np.bool_]) -> None:
        """Advance by one step, so that no near pair overlaps and no grip changes its pose."""
        pairs = self._scene.pairs[near]
        new = np.zeros((len(pairs), FEATURES), dtype=bool)
        if not self._welds:
            self._pass(1)
            new = self._scene.touches(self._moving()[0], pairs)[..., GAP] < -TOUCH
            if not new.any():
                return
            self._restore(kept)
        impact = self._impact(pairs)
        for _ in range(MOST):
            impact.begin(new)
            change = impact.change()
            self._restore(kept)
            self._kick(change)
            self._pass(1)
            ended = self._scene.touches(self._moving()[0], pairs)[..., GAP]
            new = (ended < -TOUCH) & ~impact.on
            if not impact.improve(ended) and not new.any():
                break
        self._lost += impact.gained()
        for k, pushed in impact.pushed():
            names = self._scene.names[int(np.flatnonzero(near)[k])]
            self.touched[names] = self.touched.get(names, 0.0) + pushed
