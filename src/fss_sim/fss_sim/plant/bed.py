"""Everything that floats on the table: vehicles, targets, their grips and contacts.

A target that one gripper holds is part of its last link. Arms that hold each other, or the same
target, are welded: their last links move as one body. A grip with limits slides above them.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fss_arm_model.arrays import Floats
from fss_arm_model.held import Approach, Target, approach, payload_pose
from fss_arm_model.integration import STEP
from fss_arm_model.kinematics import tip_jacobian, tip_pose
from fss_sim.plant.contact import GAP, OVERLAPS, PAIR_SIZE, PUSHED, Contact, pair_parts
from fss_sim.plant.impact import IMPULSE, NEW_WELD, POSE, WELD_BIAS
from fss_sim.plant.simulation import ADVANCE, EMPTY_SCENE, SHORT, STOP, Scene, advance
from fss_sim.plant.target import Load, PassiveTarget, velocity_after_capture
from fss_sim.plant.vehicle import Vehicle

# Parts with a smaller initial gap overlap: they pass through each other until apart [m].
MIN_INITIAL_GAP = -2e-4
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


class Weld(NamedTuple):
    """Rigid connection of two arms: their last links move as one body."""

    one: Vehicle
    other: Vehicle
    pose: Floats  # (3,) of the tip of `other` in the frame of one's last link

    def loads(self, vehicle: Vehicle) -> bool:
        """Return True if the weld loads the vehicle's grip."""
        return self.other is vehicle or (self.one is vehicle and bool(vehicle.held))


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
        self._initial_balance = self.audit.balance

    def advance(self, seconds: float) -> None:
        """Advance the simulation by a time, in whole steps of the drives."""
        for vehicle in self.vehicles:
            self._use_gripper(vehicle)
            vehicle.fingers.force = vehicle.fingers.torque = 0.0
        steps = round(seconds / STEP)
        end, self.contact_impulses = self.step + steps, {}
        while self.step < end:
            grips = [v for v in self.vehicles if v.held and v.world.gripper.limited]
            left = end - self.step
            self.step += self._advance_grips(grips, left) if grips else self._advance(left)
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
        edges = [
            Clearance(vehicle.name or "vehicle", "table edge", vehicle.edge_clearance)
            for vehicle in self.vehicles
        ]
        return [*self._pair_clearances(), *edges]

    def nearest(self) -> Clearance:
        """Return the pair of parts with the least gap; the gap is infinite if there is no pair."""
        return min(self._pair_clearances(), key=lambda x: x.gap, default=Clearance("", "", np.inf))

    def _pair_clearances(self) -> list[Clearance]:
        gaps = self._gaps().tolist()
        return [Clearance(*names, gap) for names, gap in zip(self._names, gaps, strict=True)]

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
            elif thing is vehicle or not thing.n or thing.held not in (None, vehicle):
                continue  # the fingers of another gripper hold something else
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
                tip = tip_pose(vehicle.p, vehicle.q)
                self._welds.append(Weld(one, vehicle, payload_pose(one.p, one.q, tip)))
                self._rebuild_scene()
                self._advance(0, STOP)
        self._rebuild_scene()

    def _attach(self, vehicle: Vehicle, target: PassiveTarget) -> None:
        """Make a target part of the last link, by an impulse."""
        had, supplied = vehicle.audit_rows + target.audit_rows
        H = vehicle.inertia()
        after = velocity_after_capture(vehicle.p, vehicle.q, vehicle.qd, H, target)
        vehicle.attach(target, after)
        vehicle.audit_rows[1] = supplied
        self._contact_work += vehicle.audit_rows[0, 3] - had[3]

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
        """Return the mean load on a grip during the last advance, which took `time` [s].

        `before` is the state (2, 3), before it, of a target that is part of the last link.
        """
        payload, force, torque = vehicle.payload, 0j, 0.0
        tip = complex(*tip_pose(vehicle.p, vehicle.q)[:2].tolist())
        if payload and before is not None:
            (x, y, _), (vx, vy, turn) = payload.state.tolist()
            old_vx, old_vy, old_turn = before[1].tolist()
            force = payload.target.mass / time * complex(vx - old_vx, vy - old_vy)
            torque = payload.target.inertia / time * (turn - old_turn)
            torque += ((complex(x, y) - tip).conjugate() * force).imag
        for k, weld in enumerate(self._welds):
            if not weld.loads(vehicle):
                continue
            sign, other = 1.0 if weld.other is vehicle else -1.0, weld.other
            px, py, turn = self._scene.held[k, IMPULSE:WELD_BIAS].tolist()
            pull = sign / time * complex(px, py)
            at = tip if other is vehicle else complex(*tip_pose(other.p, other.q)[:2].tolist())
            force += pull
            torque += sign / time * turn + ((at - tip).conjugate() * pull).imag
        return Load(force, torque)

    # Motion

    def _rebuild_scene(self) -> None:
        """Determine the chains that move independently, and the pairs of parts that can touch."""
        free = [target for target in self.targets if target.is_free]
        self._chains: list[Vehicle | PassiveTarget] = [*self.vehicles, *free]
        number = {id(chain): c for c, chain in enumerate(self._chains)}
        welds = [(number[id(w.one)], number[id(w.other)], *w.pose) for w in self._welds]
        rigid = {frozenset(row[:2]) for row in welds}
        for vehicle in self.vehicles:
            if vehicle.fingers.slides and id(vehicle.held) in number:
                rigid.add(frozenset((number[id(vehicle)], number[id(vehicle.held)])))
        counts, parts = [c.n for c in self._chains], [c.parts() for c in self._chains]
        self._names, pairs, table = pair_parts(counts, parts, rigid)
        touched, held = np.zeros((len(pairs), PAIR_SIZE)), np.tile(NEW_WELD, (len(welds), 1))
        grips = np.array(welds, dtype=float).reshape(-1, POSE + 3)
        self._scene = Scene(table, pairs, touched, grips, held)
        self._scene.touched[:, OVERLAPS] = self._gaps() < MIN_INITIAL_GAP

    def _gaps(self) -> Floats:
        """Return each pair's gap [m], and update the audit."""
        scene, _, _ = advance(self._chains, self._scene, 0, self.step)
        return scene.touched[:, GAP]

    def _advance(self, steps: int, way: int = ADVANCE) -> int:
        """Advance by at most some steps; return their number."""
        scene, law = self._scene, self.contact
        if not law:
            scene = scene._replace(pairs=EMPTY_SCENE.pairs, touched=EMPTY_SCENE.touched)
        scene, done, work = advance(self._chains, scene, steps, self.step, self.tolerance, law, way)
        self._contact_work += work
        self._scene = scene if law else self._scene._replace(held=scene.held)
        for pair in np.flatnonzero(scene.touched[:, PUSHED]):
            names, pushed = self._names[pair], float(scene.touched[pair, PUSHED])
            self.contact_impulses[names] = self.contact_impulses.get(names, 0.0) + pushed
        return done

    def _advance_grips(self, grips: Sequence[Vehicle], max_steps: int) -> int:
        """Advance by at most some steps; a grip holds while its load is within its limits.

        The load is that of a grip that holds. A step in which one slides is computed once more.
        Return the number of steps.
        """
        targets = {v: v.held for v in grips if isinstance(v.held, PassiveTarget)}
        before = {v: t.state for v, t in targets.items() if self._carrier(t) in (v, None)}
        chains = [(chain, chain.snapshot) for chain in self._chains]
        work, impulses, scene = self._contact_work, dict(self.contact_impulses), self._scene

        def restore() -> None:
            for chain, snapshot in chains:
                chain.snapshot = snapshot
            self._contact_work, self.contact_impulses = work, dict(impulses)

        sliding = [v for v in targets if v.fingers.slides]
        for vehicle in sliding:
            self._attach(vehicle, targets[vehicle])
        if sliding:
            self._rebuild_scene()
        count = self._advance(1 if sliding else max_steps, SHORT)
        while True:
            loads = {v: self._load(v, before.get(v), count * STEP) for v in grips}
            shares = {v: load.share(v.world.gripper) for v, load in loads.items()}
            if count == 1 or max(shares.values()) < MAX_MEAN_SHARE:
                break
            restore()
            self._scene = scene
            count = self._advance(count // 2, SHORT)
        over = [v for v in grips if shares[v] > 1.0]
        slipping = [v for v in over if v in targets and not any(w.loads(v) for w in self._welds)]
        lost = [v for v in over if v not in slipping]
        loads |= {v: loads[v].scaled(1.0 / shares[v]) for v in slipping}
        if slipping:
            slipping += [v for v in sliding if v not in slipping]
            for vehicle in slipping:
                vehicle.let_slide(targets[vehicle], before[vehicle])
            restore()
            self._slide({v: (targets[v], loads[v]) for v in slipping})
            lost += [v for v in slipping if not v.world.gripper.encloses(self.within_reach(v)[1])]
        for vehicle in grips:
            vehicle.fingers.add_load(loads[vehicle], vehicle in slipping, self.step)
        for vehicle in lost:
            vehicle.fingers.missed = True
            vehicle.fingers.losses += 1
            self._release(vehicle)
        return count

    def _slide(self, grips: dict[Vehicle, tuple[PassiveTarget, Load]]) -> None:
        """Advance by one step in which grips transmit these loads."""
        self._rebuild_scene()
        energy = self.audit.energy
        for vehicle, (target, load) in grips.items():
            fx, fy, torque = load.force.real, load.force.imag, load.torque
            pull = tip_jacobian(vehicle.p, vehicle.q).T @ [fx, fy, torque]
            vehicle.add_velocity(np.asarray(np.linalg.solve(vehicle.inertia(), -STEP * pull)))
            x, y = (tip_pose(vehicle.p, vehicle.q) - target.q)[:2].tolist()
            target.add_velocity(STEP * np.array([fx, fy, torque + x * fy - y * fx]) / target.masses)
        self._gaps()
        self._contact_work += self.audit.energy - energy
        self._advance(1)
