"""The table with all that floats on it: vehicles and targets, what they grip and what they hit.

Between contacts each chain moves on by itself, many steps in one call. How many steps nobody can
touch anybody is judged from gaps and speeds, and checked afterwards. In a step that would end with
two parts in each other, or in which arms hold each other, impulses at its begin make it end well:

    parts   gap >= 0, by contact.py's law of impact
    grips   the pose of one gripper, as seen from the other, stays what it was

so that what leans on each other, or pulls, touches at the end of each step, as constraints hold in
SHAKE (Ryckaert, Ciccotti & Berendsen 1977). Both chains get an impulse at the same point, so that
momentum stays; its work is booked.
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

REACH = 5e-3  # [m]: so near, or what they move in two steps, are parts that may touch in one
ALREADY = -2e-4  # [m]: parts that overlap by more at first pass through each other until apart
AMPLE = 10  # times the time to pass: so long until somebody may touch needs no check afterwards
MOST = 8  # trials of a step
TIP = Target(fixture=(0.0, 0.0, 0.0))  # a gripper, as what another grips
FAR = Approach(np.inf, 0.0, 0.0)


class Audit(NamedTuple):
    """Books on momentum and energy; what is there, less what was given, stays what it was."""

    momentum: Floats  # linear, x and y [N s], and angular about the world's origin [N m s]
    energy: float  # kinetic, and of the gears' springs [J]
    impulse: Floats  # (3,) given from outside since the begin, and carried away by propellant
    work: float  # done since the begin by all forces, those of contacts and captures too [J]
    contact: float = 0.0  # of it, by contacts and captures; it only falls [J]

    @property
    def balance(self) -> Floats:
        """What never changes, (4,)."""
        return np.append(self.momentum - self.impulse, self.energy - self.work)


class Clearance(NamedTuple):
    """Two parts, and the gap between them."""

    one: str
    other: str
    gap: float  # below 0 they overlap [m]


class Bed:
    """All that floats on one table.

    Args:
        vehicles: each as it is at the begin.
        targets: as they are at the begin.
        contact: how bodies meet; None: they pass through each other.
        tolerance: of error control; 0: fixed steps.
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
        self.touched: dict[tuple[str, str], float] = {}  # in the last `advance` [N s]
        self._welds: list[Weld] = []
        self._lost = 0.0  # in contacts and captures [J]
        for vehicle in self.vehicles:
            vehicle.bed = self
        self._arrange()
        self._pass(0)
        self._begin = self.audit.balance

    def advance(self, seconds: float) -> None:
        """Let time pass, in whole steps of the drives."""
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
        """The books of all bodies as they are now."""
        has, given = np.sum([chain.books for chain in self._chains], axis=0)
        work = float(given[3]) + self._lost
        return Audit(has[:3], float(has[3]), given[:3], work, self._lost)

    @property
    def imbalance(self) -> Floats:
        """What the books are off by since the begin, (4,) [N s, N s, N m s, J]."""
        return self.audit.balance - self._begin

    def clearances(self) -> list[Clearance]:
        """Every two parts that can touch, and each vehicle and the table's edge."""
        found = [
            Clearance(*names, gap)
            for names, gap in zip(self._scene.names, self._room()[:, 0].tolist(), strict=True)
        ]
        for vehicle in self.vehicles:
            name, gap = vehicle.name or "vehicle", vehicle.edge_clearance
            found.append(Clearance(name, "table edge", gap))
        return found

    def nearest(self) -> Clearance:
        """The two parts with the least gap; infinitely far if there are no two."""
        gaps = self._room()[:, 0]
        if not gaps.size:
            return Clearance("", "", np.inf)
        least = int(np.argmin(gaps))
        return Clearance(*self._scene.names[least], float(gaps[least]))

    def within_reach(self, vehicle: "Vehicle") -> "tuple[Vehicle | Passive | None, Approach]":
        """What the vehicle holds or else is nearest to its gripper, as its end effector sees it."""
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
        """Have the fingers do what they are told; on closing they wait until something is there."""
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
        """Close on something: momentum stays, and what is lost of the energy is booked."""
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
        """Have all that arms hold together move as one at once, as they close on it."""
        impact = self._impact(self._scene.pairs[:0])
        self._kick(impact.change())
        self._pass(0)
        self._lost += impact.gained()

    def _release(self, vehicle: "Vehicle") -> None:
        """Let go; who else holds the target has it alone."""
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
        """Whether what the grip passed on was more than the fingers hold.

        `before` is the twist a time ago of the target that is part of the vehicle's last link.
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
        """Who moves by itself, and what may touch what."""
        free = [target for target in self.targets if target.holder is None]
        self._chains: list[Vehicle | Passive] = [*self.vehicles, *free]
        number = {id(chain): c for c, chain in enumerate(self._chains)}
        rigid = {frozenset((number[id(w.one)], number[id(w.other)])) for w in self._welds}
        parts = [chain.parts() for chain in self._chains]
        self._scene = Scene([chain.p for chain in self._chains], parts, rigid)
        self._past = self._room()[:, 0] < ALREADY

    def _room(self) -> Floats:
        """Of each pair of parts, (g, 2): gap, and no less than the speed it closes with."""
        return self._scene.room(*self._moving())

    def _moving(self) -> tuple[Floats, Floats]:
        q = np.concatenate([chain.q for chain in self._chains])
        return q, np.concatenate([chain.qd for chain in self._chains])

    def _impact(self, pairs: Floats) -> Impact:
        """What is to make a step end well, in which these pairs may touch."""
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
        """At most so many steps: those in which nobody touches anybody, or one."""
        loaded = [v for v in self.vehicles if v.held and v.world.gripper.limited]
        before = [v.held.state[1] if isinstance(v.held, Passive) else None for v in loaded]
        count = self._steps(most)
        self.step += count
        for vehicle, twist in zip(loaded, before, strict=True):
            if vehicle.held and self._overloaded(vehicle, twist, count * STEP):
                vehicle.fingers.missed = True
                self._release(vehicle)

    def _steps(self, most: int) -> int:
        """Let steps pass; return how many."""
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
        """End a step with none of the near pairs in each other, and all grips as they were."""
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
