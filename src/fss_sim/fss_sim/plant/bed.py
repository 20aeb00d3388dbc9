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
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fss_arm_model.arrays import Floats
from fss_arm_model.held import Approach, Target, approach
from fss_arm_model.integration import STEP
from fss_arm_model.kinematics import tip_jacobian, tip_pose
from fss_sim.plant.contact import FEATURES, GAP, Contact, Scene
from fss_sim.plant.impact import GAP_TOLERANCE, Impact
from fss_sim.plant.target import Load, PassiveTarget, velocity_after_capture
from fss_sim.plant.vehicle import Vehicle
from fss_sim.plant.weld import Weld

# Parts can touch in one step within this gap plus their motion in two steps [m].
CONTACT_RANGE = 5e-3
# Parts with a smaller initial gap overlap: they pass through each other until apart [m].
MIN_INITIAL_GAP = -2e-4
# No check afterwards if the time to a possible contact is this multiple of the advance.
SAFE_RATIO = 10
MAX_TRIALS = 8  # of a step
MAX_MEAN_SHARE = 0.5  # mean load on a grip over several steps, as a share of its limits
TIP_FIXTURE = Target(fixture=(0.0, 0.0, 0.0))  # a gripper that another gripper can hold
NO_APPROACH = Approach(np.inf, 0.0, 0.0)


class Audit(NamedTuple):
    """Audit of momentum and energy: present amount minus amount supplied is constant."""

    momentum: Floats  # linear, x and y [N s], and angular about the world's origin [N m s]
    energy: float  # kinetic, and of the gears' springs [J]
    impulse: Floats  # (3,) external since the start, including what propellant carries away
    work: float  # of all forces since the start, including contacts and captures [J]
    # Part of `work` by contacts, captures and sliding grips [J]; it decreases, but for some 1e-5 J
    # in the steps of a grip that slides.
    contact: float = 0.0

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
        vehicles: Sequence[Vehicle],
        targets: Sequence[PassiveTarget] = (),
        contact: Contact | None = None,
        tolerance: float = 0.0,
    ) -> None:
        self.vehicles, self.targets = list(vehicles), list(targets)
        self.contact, self.tolerance, self.step = contact, tolerance, 0
        self.contact_impulses: dict[tuple[str, str], float] = {}  # in the last `advance` [N s]
        self._welds: list[Weld] = []
        self._contact_work = 0.0  # energy change by contacts and captures [J]
        self._rebuild_scene()
        self._advance_chains(0)
        self._initial_balance = self.audit.balance

    def advance(self, seconds: float) -> None:
        """Advance the simulation by a time, in whole steps of the drives."""
        for vehicle in self.vehicles:
            self._use_gripper(vehicle)
            vehicle.fingers.force = vehicle.fingers.torque = 0.0
        start, steps = self.step, round(seconds / STEP)
        self.contact_impulses = {}
        while self.step < start + steps:
            self._advance_watched(start + steps - self.step)
        for vehicle in self.vehicles:
            vehicle.end_steps(steps)

    @property
    def audit(self) -> Audit:
        """Momentum and energy audit of all bodies at present."""
        present, supplied = np.sum([chain.audit_rows for chain in self._chains], axis=0)
        work = float(supplied[3]) + self._contact_work
        return Audit(present[:3], float(present[3]), supplied[:3], work, self._contact_work)

    @property
    def imbalance(self) -> Floats:
        """Error of the audit since the start, (4,) [N s, N s, N m s, J]."""
        return self.audit.balance - self._initial_balance

    def clearances(self) -> list[Clearance]:
        """Return the gap of each pair of parts that can touch, and of each vehicle to the edge."""
        found = [
            Clearance(*names, gap)
            for names, gap in zip(self._scene.names, self._gaps()[:, 0].tolist(), strict=True)
        ]
        for vehicle in self.vehicles:
            name, gap = vehicle.name or "vehicle", vehicle.edge_clearance
            found.append(Clearance(name, "table edge", gap))
        return found

    def nearest(self) -> Clearance:
        """Return the pair of parts with the least gap; the gap is infinite if there is no pair."""
        gaps = self._gaps()[:, 0]
        if not gaps.size:
            return Clearance("", "", np.inf)
        least = int(np.argmin(gaps))
        return Clearance(*self._scene.names[least], float(gaps[least]))

    def within_reach(self, vehicle: Vehicle) -> tuple[Vehicle | PassiveTarget | None, Approach]:
        """Return the thing that the vehicle holds, or else the nearest to its gripper.

        The second value is the approach to it: distance, angle and speed.
        """
        found: list[tuple[Vehicle | PassiveTarget, Approach]] = []
        things: list[Vehicle | PassiveTarget] = [*self.targets, *self.vehicles]
        for thing in things if vehicle.n else ():
            if isinstance(thing, PassiveTarget):
                gripper_approach = approach(
                    vehicle.p, vehicle.q, vehicle.qd, thing.target, thing.state
                )
            elif thing is vehicle or not thing.n:
                continue
            else:
                twist = tip_jacobian(thing.p, thing.q) @ thing.qd
                tip = np.array([tip_pose(thing.p, thing.q), twist])
                gripper_approach = approach(vehicle.p, vehicle.q, vehicle.qd, TIP_FIXTURE, tip)
            if thing is vehicle.held:
                return thing, gripper_approach
            found.append((thing, gripper_approach))
        return min(found, key=lambda one: one[1].distance, default=(None, NO_APPROACH))

    # Grips

    def _use_gripper(self, vehicle: Vehicle) -> None:
        """Move the fingers as commanded; to close, they wait until a fixture is within reach."""
        fingers, gripper = vehicle.fingers, vehicle.world.gripper
        if not vehicle.closed:
            fingers.closing_since, fingers.missed = None, False
            if vehicle.held:
                self._release(vehicle)
            return
        if vehicle.held or fingers.missed:
            return
        thing, gripper_approach = self.within_reach(vehicle)
        in_reach = gripper.can_grip(gripper_approach)
        if fingers.closing_since is None and in_reach:
            fingers.closing_since = self.step
        if fingers.closing_since is None:
            return
        if self.step - fingers.closing_since < round(gripper.closing_time / STEP):
            return
        if any(v.held is thing and v.fingers.slides for v in self.vehicles):
            return  # wait until it rests in the other gripper
        if in_reach and thing:
            self._grip(vehicle, thing)
        else:
            fingers.missed = True

    def _grip(self, vehicle: Vehicle, thing: Vehicle | PassiveTarget) -> None:
        """Grip a thing: momentum is conserved, and the energy lost enters the audit."""
        vehicle.held, gripper = thing, vehicle.world.gripper
        if isinstance(thing, PassiveTarget) and thing.is_free:
            vehicle.fingers.slides, vehicle.fingers.last_slide = gripper.limited, self.step
            if not gripper.limited:
                self._attach(vehicle, thing)
        else:
            one = self._carrier(thing)
            assert one is not None
            if not any({w.one, w.other} == {one, vehicle} for w in self._welds):
                self._welds.append(Weld(one, vehicle))
                self._rebuild_scene()
                self._stop_relative_motion()
        self._rebuild_scene()

    def _attach(self, vehicle: Vehicle, target: PassiveTarget) -> None:
        """Make a target part of the last link, by an impulse."""
        had, supplied = vehicle.audit_rows + target.audit_rows
        H = vehicle.inertia()
        after = velocity_after_capture(vehicle.p, vehicle.q, vehicle.qd, H, target)
        vehicle.attach(target, after)
        vehicle.audit_rows[1] = supplied
        self._contact_work += vehicle.audit_rows[0, 3] - had[3]

    def _stop_relative_motion(self) -> None:
        """Stop the relative motion of arms that hold each other by an impulse, as a grip closes."""
        impact = self._impact(self._scene.pairs[:0])
        self._add_velocity(impact.velocity_change())
        self._advance_chains(0)
        self._contact_work += impact.work()

    def _release(self, vehicle: Vehicle) -> None:
        """Release the thing held; another vehicle that holds the target keeps it."""
        thing, vehicle.held, vehicle.fingers.slides = vehicle.held, None, False
        others = [v for v in self.vehicles if v.held is thing and not v.fingers.slides]
        if isinstance(thing, PassiveTarget) and vehicle.payload is thing:
            vehicle.detach(thing)
            self._welds = [w for w in self._welds if w.one is not vehicle or w.other not in others]
            self._rebuild_scene()
            for other in others:
                self._grip(other, thing)
            return
        if thing and (isinstance(thing, PassiveTarget) or thing.held is not vehicle):
            pair = {self._carrier(thing), vehicle}
            self._welds = [w for w in self._welds if {w.one, w.other} != pair]
        self._rebuild_scene()

    def _carrier(self, thing: Vehicle | PassiveTarget) -> Vehicle | None:
        """Return the vehicle that a thing is part of; None: a target that floats freely."""
        if isinstance(thing, PassiveTarget):
            return next((one for one in self.vehicles if one.payload is thing), None)
        return thing

    def _load(self, vehicle: Vehicle, before: Floats | None, time: float) -> Load:
        """Return the load on a grip.

        `before` is the state (2, 3), `time` [s] ago, of a target that is part of the last link.
        """
        payload, force, torque = vehicle.payload, 0j, 0.0
        tip = complex(*tip_pose(vehicle.p, vehicle.q)[:2])
        if payload and before is not None:
            (x, y, _), after = payload.state
            gained = (after - before[1]) / time * payload.masses
            force = complex(gained[0], gained[1])
            torque = gained[2] + (np.conj(complex(x, y) - tip) * force).imag
        for weld in self._welds_of(vehicle):
            sign = 1.0 if weld.other is vehicle else -1.0
            load = sign * weld.impulse / STEP
            at = complex(*tip_pose(weld.other.p, weld.other.q)[:2])
            force += complex(load[0], load[1])
            torque += load[2] + (np.conj(at - tip) * complex(load[0], load[1])).imag
        return Load(force, float(torque))

    def _welds_of(self, vehicle: Vehicle) -> list[Weld]:
        """Return the welds that load the vehicle's grip."""
        return [w for w in self._welds if w.other is vehicle or (w.one is vehicle and vehicle.held)]

    # Motion

    def _rebuild_scene(self) -> None:
        """Determine the chains that move independently, and the pairs of parts that can touch."""
        free = [target for target in self.targets if target.is_free]
        self._chains: list[Vehicle | PassiveTarget] = [*self.vehicles, *free]
        number = {id(chain): c for c, chain in enumerate(self._chains)}
        rigid = {frozenset((number[id(w.one)], number[id(w.other)])) for w in self._welds}
        for vehicle in self.vehicles:
            if vehicle.fingers.slides and id(vehicle.held) in number:
                rigid.add(frozenset((number[id(vehicle)], number[id(vehicle.held)])))
        parts = [chain.parts() for chain in self._chains]
        self._scene = Scene([chain.p for chain in self._chains], parts, rigid)
        self._overlapping = self._gaps()[:, 0] < MIN_INITIAL_GAP

    def _gaps(self) -> Floats:
        """Return each pair's gap [m], and an upper bound of its closing speed [m/s], (g, 2)."""
        return self._scene.gaps(*self._moving())

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

    def _advance_chains(self, steps: int) -> None:
        for chain in self._chains:
            chain.advance_steps(steps, self.step, self.tolerance)

    def _restore(self, snapshot: Sequence[tuple[Floats, ...]]) -> None:
        for chain, state in zip(self._chains, snapshot, strict=True):
            chain.snapshot = state

    def _add_velocity(self, change: Floats) -> None:
        for chain, part in zip(self._chains, self._scene.slices, strict=True):
            chain.add_velocity(change[part])

    def _advance_watched(self, max_steps: int) -> None:
        """Advance by at most `max_steps`; a grip holds while its load is within its limits.

        The load is that of a grip that holds. A step in which one slides is computed once more.
        """
        grips = [v for v in self.vehicles if v.held and v.world.gripper.limited]
        targets = {v: v.held for v in grips if isinstance(v.held, PassiveTarget)}
        before = {v: target.state for v, target in targets.items()}
        chains = [(chain, chain.snapshot) for chain in self._chains]
        audit = self._contact_work, dict(self.contact_impulses)
        sliding = [v for v in targets if v.fingers.slides]
        for vehicle in sliding:
            self._attach(vehicle, targets[vehicle])
        if sliding:
            self._rebuild_scene()
        count = self._advance_free(1 if sliding else max_steps)
        while True:
            loads = {v: self._load(v, before.get(v), count * STEP) for v in grips}
            shares = {v: load.share(v.world.gripper) for v, load in loads.items()}
            if count == 1 or max(shares.values(), default=0.0) < MAX_MEAN_SHARE:
                break
            self._restore([snapshot for _, snapshot in chains])
            count = self._advance_free(count // 2)
        over = [v for v in grips if shares[v] > 1.0]
        slipping = [v for v in over if v in targets and not self._welds_of(v)]
        lost = [v for v in over if v not in slipping]
        if slipping:
            for vehicle in slipping:
                loads[vehicle] = loads[vehicle].scaled(1.0 / shares[vehicle])
            slipping += [v for v in sliding if v not in slipping]
            for vehicle in slipping:
                vehicle.let_slide(targets[vehicle], before[vehicle])
            for chain, snapshot in chains:
                chain.snapshot = snapshot
            self._contact_work, self.contact_impulses = audit
            self._slide({v: (targets[v], loads[v]) for v in slipping})
            lost += [v for v in slipping if not v.world.gripper.encloses(self.within_reach(v)[1])]
        for vehicle in grips:
            vehicle.fingers.add_load(loads[vehicle], vehicle in slipping, self.step)
        self.step += count
        for vehicle in lost:
            vehicle.fingers.missed = True
            vehicle.fingers.losses += 1
            self._release(vehicle)

    def _slide(self, grips: dict[Vehicle, tuple[PassiveTarget, Load]]) -> None:
        """Advance by one step in which grips transmit these loads."""
        self._rebuild_scene()
        self._advance_chains(0)
        energy = self.audit.energy
        for vehicle, (target, load) in grips.items():
            fx, fy, torque = load.force.real, load.force.imag, load.torque
            pull = tip_jacobian(vehicle.p, vehicle.q).T @ [fx, fy, torque]
            vehicle.add_velocity(np.asarray(np.linalg.solve(vehicle.inertia(), -STEP * pull)))
            x, y = (tip_pose(vehicle.p, vehicle.q) - target.q)[:2].tolist()
            target.add_velocity(STEP * np.array([fx, fy, torque + x * fy - y * fx]) / target.masses)
        self._advance_chains(0)
        self._contact_work += self.audit.energy - energy
        self._advance_free(1)

    def _advance_free(self, max_steps: int) -> int:
        """Advance by steps without contact, or by one step; return their number."""
        if not (self._welds or (self.contact and self._scene.names)):
            self._advance_chains(max_steps)
            return max_steps
        gaps = self._gaps()
        self._overlapping &= gaps[:, 0] < 0.0
        watched = gaps[~self._overlapping] if self.contact else gaps[:0]
        slack = (watched[:, 0] / (1.5 * watched[:, 1] + 0.05)).min(initial=np.inf) / STEP
        count = 1 if self._welds else int(min(max(slack, 1.0), max_steps))
        snapshot = [chain.snapshot for chain in self._chains]
        while count > 1:
            self._advance_chains(count)
            if slack >= SAFE_RATIO * count:
                return count
            after = self._gaps()[~self._overlapping]
            travel = STEP * count * np.maximum(watched[:, 1], after[:, 1])
            if (watched[:, 0] + after[:, 0] > travel).all():
                return count
            self._restore(snapshot)
            count //= 2
        close = ~self._overlapping & (gaps[:, 0] < CONTACT_RANGE + 2.0 * STEP * gaps[:, 1])
        self._advance_with_contact(snapshot, close if self.contact else np.zeros_like(close))
        return 1

    def _advance_with_contact(
        self, snapshot: Sequence[tuple[Floats, ...]], close: npt.NDArray[np.bool_]
    ) -> None:
        """Advance by one step, so that no near pair overlaps and no grip changes its pose."""
        pairs = self._scene.pairs[close]
        new = np.zeros((len(pairs), FEATURES), dtype=bool)
        if not self._welds:
            self._advance_chains(1)
            new = self._scene.touches(self._moving()[0], pairs)[..., GAP] < -GAP_TOLERANCE
            if not new.any():
                return
            self._restore(snapshot)
        impact = self._impact(pairs)
        for _ in range(MAX_TRIALS):
            impact.add_contacts(new)
            change = impact.velocity_change()
            self._restore(snapshot)
            self._add_velocity(change)
            self._advance_chains(1)
            ended = self._scene.touches(self._moving()[0], pairs)[..., GAP]
            new = (ended < -GAP_TOLERANCE) & ~impact.touching
            if not impact.correct_goals(ended) and not new.any():
                break
        self._contact_work += impact.work()
        for k, pushed in impact.pair_impulses():
            names = self._scene.names[int(np.flatnonzero(close)[k])]
            self.contact_impulses[names] = self.contact_impulses.get(names, 0.0) + pushed
