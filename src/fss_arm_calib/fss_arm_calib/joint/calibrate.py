"""Joint estimate from the data of several sessions: the solution and its checks."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import yaml

from fss_arm_calib import checks
from fss_arm_calib.acceptance import FIT, Check, format_count
from fss_arm_calib.calibration import Calibration
from fss_arm_calib.dynamic.knowledge import advise_priors, independent_knowledge
from fss_arm_calib.joint.problem import TOLERANCE, JointProblem, JointResult, solve
from fss_arm_calib.joint.settings import JointSettings
from fss_arm_calib.outcome import LIVE, Estimate, Outcome, estimate_of_fit, make_outcome
from fss_arm_calib.precision import check_precision, unmeasured
from fss_arm_calib.segments.streams import Datum, Streams
from fss_arm_calib.segments.telemetry import rehomed_joints
from fss_arm_model.arrays import Floats
from fss_arm_model.description import Arm
from fss_arm_model.description_file import from_yaml
from fss_arm_model.parameters import unit, values
from fss_arm_model.planar import wrap
from fss_arm_model.units import GRAVITY

Kinds = Mapping[str, Calibration[Any, Any]]

UNITS = {"torque": "N m", "twist_damping": "N m s", "drag": "N s/m"}


@dataclass(frozen=True)
class Session:
    """Data by kind, all recorded with the same tilt, hose and joint zeros."""

    name: str
    data: Mapping[str, Sequence[Any]]
    streams: Mapping[str, Streams] = field(default_factory=dict)

    def of(self, kind: str) -> Streams:
        """Return the events in the streams that data of a kind come from."""
        return self.streams.get(kind, Streams())


def split_at_homings(session: Session) -> Iterator[Session]:
    """Split a session where a rest shows that a joint was homed."""
    rests = [one for one in session.data.get("kinematic", ()) if one.used]
    cuts = [b.start for a, b in pairwise(rests) if rehomed_joints(a, b)]
    for k, (start, end) in enumerate(zip([0, *cuts], [*cuts, 2**63], strict=True), 1):
        data = {
            kind: [one for one in some if start <= one.start < end]
            for kind, some in session.data.items()
        }
        name = f"{session.name}, homed {format_count(k - 1, 'time')}" if cuts else session.name
        yield replace(session, name=name, data=data)


@dataclass(frozen=True)
class StagedResults:
    """Results of the single calibrations of a session, one after the other."""

    arm: Arm  # with the results of the calibrations that passed
    used: dict[str, list[Any]]  # data that were not rejected
    outcomes: dict[str, Outcome[Any, Any]]
    settings: dict[str, Any]  # of each kind, with the estimated deviations of observations


def run_stages(
    session: Session, arm: Arm, kinds: Kinds, settings: Mapping[str, Any]
) -> StagedResults:
    """Calibrate a session by kinds, each from the arm of the last one that passed."""
    used, outcomes, known = {}, {}, dict(settings)
    for name, kind in kinds.items():
        data = session.data.get(name, ())
        if not any(one.used for one in data) or not kind.measurements:
            continue
        outcome = kind.calibrate(data, arm, settings[name], session.of(name), LIVE)
        weights = outcome.estimate.weights
        kept = weights > 0.0 if len(weights) else np.ones(len(outcome.used), dtype=bool)
        used[name] = [one for one, well in zip(outcome.used, kept, strict=True) if well]
        outcomes[name] = outcome
        if noise := getattr(outcome.solution, "noise", None):  # drifts have given deviations
            known[name] = noise.apply_to(settings[name])
        arm = from_yaml(outcome.description) if outcome.description else arm
    return StagedResults(arm, used, outcomes, known)


class SessionParameter(NamedTuple):
    """Parameter of a single session."""

    session: str
    name: str
    unit: str
    value: float  # for a joint's zero, relative to the last session
    deviation: float


@dataclass(frozen=True)
class Solution:
    """Result, and the sessions that it uses."""

    result: JointResult
    sessions: tuple[str, ...]
    number: tuple[dict[str, int], ...]  # number of data by kind, for each session

    def session_parameters(self) -> Iterator[SessionParameter]:
        """Yield the parameters of each session."""
        for k, session in enumerate(self.sessions):
            names = self.result.problem.session_names(k)
            values, deviations = self.result.session(k)
            for name, *numbers in zip(names, values.tolist(), deviations.tolist(), strict=True):
                yield SessionParameter(session, name, UNITS.get(name) or unit(name), *numbers)


def problem_of(
    used: Sequence[Mapping[str, Sequence[Any]]],
    arm: Arm,
    s: JointSettings,
    kinds: Kinds,
    settings: Mapping[str, Any],
    session_settings: Sequence[Mapping[str, Any]] = (),
) -> JointProblem:
    """Return the joint problem of the data `used` of each session, by kind.

    `settings` are those of the kinds; `session_settings` those of each session, if the deviations
    of observations differ.
    """
    sessions = []
    for data, its in zip(used, session_settings or len(used) * [settings], strict=True):
        every = ((name, kinds[name].measurements) for name in data)
        sessions.append({name: make(data[name], arm, its[name]) for name, make in every if make})
    all_data = [one for data in used for some in data.values() for one in some]
    arm = independent_knowledge(arm, all_data, ())
    fixed = [name for name in arm.known.names if not name.startswith("theta")]
    arm = replace(arm, known=arm.known.only(fixed))  # homing again changes the angles
    prior = np.pad(s.covariance(arm), (0, int(s.theta_e)))
    tilt, hose = GRAVITY * settings["dynamic"].tilt_deviation, settings["drift"]
    acting = [tilt, tilt, hose.torque_deviation, hose.twist_deviation, hose.drag_deviation]
    known, surroundings = s.prior_indices(arm, s.priors), np.array(acting)
    return JointProblem(arm, sessions, prior, known, surroundings, s.zero_deviation, s.theta_e)


def initial_unknowns(problem: JointProblem, arms: Sequence[Arm]) -> Floats:
    """Return initial values of all unknowns, from the arms that the stages found per session."""
    n, last = problem.arm.n, arms[-1]
    zeros = [*range(4 + n, 3 + 2 * n), 2 * n + 5]
    moved = []
    for k, arm in enumerate(arms):
        own = np.zeros(len(problem.session_names(k)))
        if "theta_BJ1" in problem.session_names(k):
            own[:n] = wrap((values(arm) - values(last))[zeros])
        moved.append(own)
    return problem.start(moved, replace(problem, arm=last).guess)


def calibrate(
    sessions: Sequence[Session],
    arm: Arm,
    settings: JointSettings,
    kinds: Kinds,
    of_kinds: Mapping[str, Any],
    source: str = LIVE,
) -> Outcome[Datum, Solution]:
    """Solve for one arm from the sessions, in order of time, and check the result.

    It starts from `arm` with its covariance. `of_kinds` are the settings of the kinds.
    """
    s = settings
    kinematic = replace(of_kinds["kinematic"], theta_e=s.theta_e)
    of_kinds = {**of_kinds, "kinematic": kinematic}
    parts = [one for session in sessions for one in split_at_homings(session)]
    found = [(one, run_stages(one, arm, kinds, of_kinds)) for one in parts]
    found = [(one, stage) for one, stage in found if stage.used]
    used = [stage.used for _, stage in found]
    received = [one for session in sessions for one in session.streams.values()]
    odd = (one for one in received if one.silent or one.unknown)
    streams = next(odd, received[0] if received else Streams())
    words = _format_counts(used, kinds) if found else "no rest, maneuver or drift can be used"
    count = len({kind for data in used for kind in data})
    number = format_count(len(used), "session")
    criteria = [
        checks.joint_names(streams, arm),
        _check_session_clocks(sessions, of_kinds),
        checks.data_amount("data", count, 1, words, streams, number),
    ]
    solution: Solution | None = None
    calibrated: Callable[[], Arm] | None = None
    session_settings = [stage.settings for _, stage in found]
    problem = problem_of(used, arm, s, kinds, of_kinds, session_settings)
    estimate = Estimate(problem.names, problem.units, problem.guess)
    if found:
        start = initial_unknowns(problem, [stage.arm for _, stage in found])
        result = solve(problem, start)
        numbers = tuple({kind: len(some) for kind, some in data.items()} for data in used)
        solution = Solution(result, tuple(one.name for one, _ in found), numbers)
        criteria += evaluate(result, s)
        calibrated, vague = result.calibrated, unmeasured(problem, result.deviations)
        estimate = estimate_of_fit(result, chi_square=result.minimum.cost, unmeasured=vague)
    hashes = [o.provenance.data_hash for _, stage in found for o in stage.outcomes.values()]
    arrays = [np.frombuffer("".join(hashes).encode(), dtype=np.uint8)]
    every = [one for part in parts for some in part.data.values() for one in some]
    in_time: list[Datum] = [one for data in used for some in data.values() for one in some]
    in_time.sort(key=lambda one: one.end)
    context = arm, s, JointSettings, streams, source
    outcome = make_outcome(
        every, in_time, arrays, *context, criteria, estimate, solution, calibrated
    )
    origin = replace(outcome.provenance, parameters=_settings_yaml(s, of_kinds))
    return replace(outcome, provenance=origin)


def _check_session_clocks(sessions: Sequence[Session], of_kinds: Mapping[str, Any]) -> Check:
    """Check that no clock of any session jumped back far enough to hide events."""
    every = (
        checks.clocks(streams, of_kinds[kind].joint_gap)
        for session in sessions
        for kind, streams in session.streams.items()
    )
    return max(every, key=lambda check: check.needed, default=checks.clocks(Streams(), 0.0))


def _format_counts(used: Sequence[Mapping[str, Sequence[Any]]], kinds: Kinds) -> str:
    total = {kind: sum(len(data.get(kind, ())) for data in used) for kind in kinds}
    parts = [format_count(k, kinds[kind].data.noun) for kind, k in total.items() if k]
    return f"{', '.join(parts)} of {format_count(len(used), 'session')}"


def _settings_yaml(s: JointSettings, of_kinds: Mapping[str, Any]) -> str:
    kinds = ((name, type(one), one) for name, one in of_kinds.items())
    settings = {
        name: {f.name: getattr(one, f.name) for f in fields(kind)}
        for name, kind, one in (("joint", JointSettings, s), *kinds)
    }
    return yaml.safe_dump(settings, sort_keys=False)


def evaluate(r: JointResult, s: JointSettings) -> Iterator[Check]:
    """Yield the checks of a result."""
    m = r.minimum
    yield checks.bounds(r.at_bound, advise_priors(r, s))
    yield checks.identifiability(r, advise_priors(r, s))
    yield checks.convergence(m, TOLERANCE)
    words = "residuals are larger than the deviations allow"
    yield checks.chi_square(FIT, m.cost, r.problem.degrees_of_freedom, s.min_probability, words)
    for kind, fit in r.fits.items():
        words = f"residuals of {kind} data are larger than the deviations allow"
        yield checks.hide_pass_reason(
            checks.chi_square(f"fit_{kind}", *fit, s.min_probability, words)
        )
    yield check_precision(r, s)
