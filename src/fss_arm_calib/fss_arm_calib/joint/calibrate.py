"""Joint estimate from the data of several sessions: the solution and its checks."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import yaml

from fss_arm_calib.acceptance import (
    FAIL,
    FIT,
    PASS,
    Check,
    check_chi_square,
    check_clocks,
    check_convergence,
    check_data_amount,
    check_identifiability,
    check_joint_names,
    check_limit,
    format_count,
    hide_pass_reason,
)
from fss_arm_calib.calibration import Calibration
from fss_arm_calib.estimation.least_squares import MAX_CONDITION
from fss_arm_calib.joint.problem import TOLERANCE, JointProblem, JointResult, solve
from fss_arm_calib.joint.settings import JointSettings
from fss_arm_calib.outcome import LIVE, Datum, Estimate, Outcome, make_outcome
from fss_arm_calib.segments.streams import Streams
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
    """Run each kind of calibration on a session's data.

    Each starts from the arm of the last calibration that passed.
    """
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
    """Return the joint problem of the data of all sessions.

    Args:
        used: the data of each session, by kind.
        arm: the initial guess.
        s: prior knowledge.
        kinds: table of the calibration kinds.
        settings: settings of the kinds.
        session_settings: settings of each session, if deviations differ between sessions.

    Raises:
        ValueError: the data do not match the arm.
    """
    sessions = []
    for data, its in zip(used, session_settings or len(used) * [settings], strict=True):
        every = ((name, kinds[name].measurements) for name in data)
        sessions.append({name: make(data[name], arm, its[name]) for name, make in every if make})
    n = arm.n
    size = 5 * n + 6 + s.theta_e
    prior = np.zeros((size, size))
    prior[: 5 * n + 6, : 5 * n + 6] = s.covariance(arm)
    tilt, drifting = settings["dynamic"].tilt_deviation, settings["drift"]
    return JointProblem(
        arm,
        sessions,
        prior,
        s.prior_indices(arm, s.priors),
        surroundings=np.array(
            [
                GRAVITY * tilt,
                GRAVITY * tilt,
                drifting.torque_deviation,
                drifting.twist_deviation,
                drifting.drag_deviation,
            ]
        ),
        zeros=s.zero_deviation,
        theta_e=s.theta_e,
    )


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
    """Solve for one arm from all data and check the result.

    Args:
        sessions: in order of time.
        arm: the initial guess, with its covariance.
        settings: prior knowledge and criteria.
        kinds: table of the calibration kinds.
        of_kinds: settings of the kinds.
        source: name of the source of the data.

    Raises:
        ValueError: the data do not match the arm, or a setting is impossible.
    """
    s = settings
    kinematic = replace(of_kinds["kinematic"], theta_e=s.theta_e)
    of_kinds = {**of_kinds, "kinematic": kinematic}
    parts = [one for session in sessions for one in split_at_homings(session)]
    found = [(one, run_stages(one, arm, kinds, of_kinds)) for one in parts]
    found = [(one, stage) for one, stage in found if stage.used]
    used = [stage.used for _, stage in found]
    kinds_seen = sorted({kind for data in used for kind in data})
    heard = [one for session in sessions for one in session.streams.values()]
    odd = (one for one in heard if one.silent or one.unknown)
    streams = next(odd, heard[0] if heard else Streams())
    words = _format_counts(used, kinds) if found else "no rest, maneuver or drift can be used"
    found_checks = [
        check_joint_names(streams, arm),
        _check_session_clocks(sessions, of_kinds),
        check_data_amount(
            "data", len(kinds_seen), 1, words, streams, format_count(len(used), "session")
        ),
    ]
    solution = None
    session_settings = [stage.settings for _, stage in found]
    problem = problem_of(used, arm, s, kinds, of_kinds, session_settings)
    estimate = Estimate(problem.names, problem.units, problem.guess)
    if found:
        start = initial_unknowns(problem, [stage.arm for _, stage in found])
        result = solve(problem, start)
        numbers = tuple({kind: len(some) for kind, some in data.items()} for data in used)
        solution = Solution(result, tuple(one.name for one, _ in found), numbers)
        found_checks += evaluate(result, s)
        estimate = estimate_of(result)
    hashes = [o.provenance.data_hash for _, stage in found for o in stage.outcomes.values()]
    outcome = make_outcome(
        [one for part in parts for some in part.data.values() for one in some],
        sorted((one for data in used for some in data.values() for one in some), key=_end_of),
        [np.frombuffer("".join(hashes).encode(), dtype=np.uint8)],
        arm,
        s,
        JointSettings,
        streams,
        source,
        found_checks,
        estimate,
        solution,
        solution.result.calibrated if solution else None,
    )
    return replace(
        outcome, provenance=replace(outcome.provenance, parameters=_settings_yaml(s, of_kinds))
    )


def _end_of(one: Datum) -> int:
    return one.end


def _check_session_clocks(sessions: Sequence[Session], of_kinds: Mapping[str, Any]) -> Check:
    """Check that no clock of any session jumped back far enough to hide events."""
    every = (
        check_clocks(streams, of_kinds[kind].joint_gap)
        for session in sessions
        for kind, streams in session.streams.items()
    )
    return max(every, key=lambda check: check.needed, default=check_clocks(Streams(), 0.0))


def _format_counts(used: Sequence[Mapping[str, Sequence[Any]]], kinds: Kinds) -> str:
    total = {kind: sum(len(data.get(kind, ())) for data in used) for kind in kinds}
    parts = [format_count(k, kinds[kind].data.noun) for kind, k in total.items() if k]
    return f"{', '.join(parts)} of {format_count(len(used), 'session')}"


def _settings_yaml(s: JointSettings, of_kinds: Mapping[str, Any]) -> str:
    """Write all settings as YAML."""
    kinds = ((name, type(one), one) for name, one in of_kinds.items())
    settings = {
        name: {f.name: getattr(one, f.name) for f in fields(kind)}
        for name, kind, one in (("joint", JointSettings, s), *kinds)
    }
    return yaml.safe_dump(settings, sort_keys=False)


def evaluate(r: JointResult, s: JointSettings) -> list[Check]:
    """Evaluate the checks of a result."""
    m, problem = r.minimum, r.problem
    held = r.at_bound
    words = f"at a physical bound: {', '.join(held)}" if held else ""
    missing = len(r.values) - len(m.basis.s) - len(held)
    each = [
        hide_pass_reason(
            check_chi_square(
                f"fit_{kind}",
                cost,
                free,
                s.min_probability,
                f"residuals of {kind} data are larger than the deviations allow",
            )
        )
        for kind, (cost, free) in r.fits.items()
    ]
    return [
        hide_pass_reason(
            check_identifiability(r.undetermined, missing, m.basis.condition, MAX_CONDITION)
        ),
        check_convergence(m.converged, m.iterations, m.last_update, TOLERANCE),
        Check("bounds", FAIL if held else PASS, len(held), 0, words),
        check_chi_square(
            FIT,
            m.cost,
            problem.degrees_of_freedom,
            s.min_probability,
            "residuals are larger than the deviations allow",
        ),
        *each,
        _check_precision(r, s),
    ]


def _check_precision(r: JointResult, s: JointSettings) -> Check:
    """Check the least certain parameter against the required precision."""
    sigma, units = np.sqrt(np.diag(r.covariance)), np.array(r.problem.units)
    limits = np.select(
        [np.isin(units, ["kg", "kg m^2"]), units == "m"],
        [s.max_relative * np.abs(r.problem.guess), s.max_place],
        np.inf,
    )
    k = int(np.argmax(sigma / limits))
    words = f"{r.problem.names[k]} has a deviation of {sigma[k]:.2g} {units[k]} "
    words += f"(at most {limits[k]:.2g})"
    return check_limit("precision", float(sigma[k] / limits[k]), 1.0, words, "too uncertain")


def estimate_of(r: JointResult) -> Estimate:
    """Convert the result to the estimate that all kinds of calibration share."""
    m = r.minimum
    return Estimate(
        r.problem.names,
        r.problem.units,
        r.problem.guess,
        r.values,
        r.covariance,
        undetermined=r.undetermined,
        at_bound=r.at_bound,
        chi_square=m.cost,
        degrees_of_freedom=r.problem.degrees_of_freedom,
        condition_number=m.basis.condition,
        iterations=m.iterations,
        last_update=m.last_update,
    )
