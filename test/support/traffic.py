"""Vehicles on one table with ideal bases, which follow their paths exactly, and their messages."""

from dataclasses import replace
from itertools import combinations

import numpy as np

from fss_arm_model.description import Arm, paper_arm
from fss_arm_model.units import SECOND
from fss_gnc.guidance.activity import Craft, Observation
from fss_gnc.guidance.base_motion import go_to, hold
from fss_gnc.guidance.mission_settings import MissionSettings
from fss_gnc.guidance.other_vehicles import VehicleTrack, announced, outline, outline_gap
from fss_gnc.reference import Body

PERIOD = 0.5  # of the guidance [s]
DEVIATION = 0.002  # of positions [m]


def arm_of(n: int) -> Arm:
    """The paper's arm, but with n links and the same length."""
    paper = paper_arm()
    link = paper.links[1]
    share = len(paper.links) / n
    links = tuple(replace(link, a=share * link.a, b=share * link.b, theta_0=0.0) for _ in range(n))
    return replace(paper, name=f"{n} links", links=links)


def curled(n: int) -> np.ndarray:
    """Joint angles of an arm that lies beside its base."""
    return np.array([1.2, *(n - 1) * [min(3.5 / (n - 1), 1.2)]])


class Ideal:
    """A vehicle whose base is always at its reference."""

    def __init__(self, name, names, pose, n=4, **settings):
        self.name, self.q = name, curled(n)
        arm = arm_of(n)
        self.craft = Craft(arm, MissionSettings(vehicles=names, **settings))
        self.base = Body(np.array(pose, dtype=float), np.zeros(3))
        self.tracks = {
            one: VehicleTrack(one, names.index(one) < names.index(name))
            for one in names
            if one != name
        }
        self.start, self.plan = 0.0, None
        self.activity = hold(self.craft, self.observe(0.0), pose, 0.0)
        self.commands, self.reasons, self.moves = None, [], False

    def observe(self, t):
        others = (track.predicted(round(t * SECOND)) for track in self.tracks.values())
        known = tuple(other for other in others if other)
        return Observation(
            t - self.start, self.base, None, self.q, np.zeros(len(self.q)), others=known
        )

    def go_to(self, t, goal, duration=0.0):
        self.start, self.moves = t, True
        self.activity = go_to(self.craft, self.observe(t), goal, duration, 3600.0)

    def step(self, t):
        self.commands = self.activity.step(self.observe(t))
        outcome = self.commands.outcome
        assert outcome is None or outcome.success, outcome
        self.reasons.append(self.commands.reason)
        then = self.commands.path.at(t - self.start + PERIOD)
        self.base = Body(then.pose, then.twist)

    def publish(self, t, others):
        """Send state, plan and outline to the others."""
        now = round((t + PERIOD) * SECOND)
        plan = announced(self.commands.plan, t - self.start + PERIOD)
        for other in others:
            track = other.tracks[self.name]
            track.store_state(now, self.base, DEVIATION, DEVIATION)
            track.store_plan(now, plan)
            track.outline = self.outline

    @property
    def outline(self):
        return outline(self.craft.arm.vector(), self.q, self.craft.settings)

    @property
    def arrived(self):
        return not self.moves or self.activity.arrival_time is not None


def gap(one, other):
    """Gap between the outlines of two vehicles [m]."""
    a, b = ((each.outline, each.base.pose[None]) for each in (one, other))
    return float(outline_gap(*a, *b)[0])


def fly(vehicles, until=400.0, silent=lambda name, t: False, start=0.0):
    """Fly until all have arrived; return the time and the least gap."""
    t, least = start, np.inf
    while t < until and not (t > start + 2.0 and all(one.arrived for one in vehicles)):
        for one in vehicles:
            one.step(t)
        for one in vehicles:
            if not silent(one.name, t):
                one.publish(t, [other for other in vehicles if other is not one])
        t += PERIOD
        least = min([least, *(gap(*pair) for pair in combinations(vehicles, 2))])
    return t, least
