"""Straight paths obey their constraints, end for a reason, and do not depend on the step."""

from dataclasses import replace

import numpy as np
import pytest
from model_arms import random_arm
from numpy.testing import assert_allclose

from fss_arm_model.description import paper_arm
from fss_arm_model.kinematics import tip_pose
from fss_arm_model.momentum import momentum, system_com
from fss_arm_workspace.regions.fixed import fixed_workspace, joint_limits
from fss_arm_workspace.regions.virtual import VirtualManipulator
from fss_arm_workspace.straight_path.paths import (
    AWAY_FROM_LIMITS,
    FIXED,
    FLOATING,
    MINIMUM_NORM,
    WEIGHTED,
    ZERO_REACTION,
    Rules,
    arch,
    straight_paths,
    straight_workspace,
)
from fss_arm_workspace.straight_path.redundancy import BASES, RULES
from fss_arm_workspace.straight_path.trace import REASONS

ARM = paper_arm()
AROUND = np.linspace(0.0, 2.0 * np.pi, 73)[:-1]


def random_starts(arm, count, rng):
    """Return postures within 0.6 of the limits, (count, 3 + n), with the base at the origin."""
    limits = 0.6 * joint_limits(arm)
    q = rng.uniform(limits[:, 0], limits[:, 1], (count, arm.n))
    return np.concatenate([np.zeros((count, 3)), q], axis=1)


def complex_tip(arm, q):
    tip = tip_pose(arm.vector(), q)
    return tip[..., 0] + 1j * tip[..., 1]


def on_the_way(start, direction, lengths, rules):
    """Return states on a path, from paths on tables that end after these lengths."""
    ahead, tip = np.array([np.cos(direction), np.sin(direction)]), complex_tip(ARM, start)
    found = []
    for s in lengths:
        end = np.array([tip.real, tip.imag]) + s * ahead
        table = *np.where(ahead < 0.0, end, -9.0), *np.where(ahead < 0.0, 9.0, end)
        path = straight_paths(ARM, start, direction, replace(rules, table_corners=table))
        found.append(path.last[0])
    return np.array(found)


def good_paths(rules):
    paths = straight_paths(ARM, arch(ARM), AROUND, rules)
    paths = paths[~paths.grazes]
    assert len(paths.direction) > 0.7 * len(AROUND)
    return paths[::8]


@pytest.mark.parametrize("base", BASES)
@pytest.mark.parametrize("rule", RULES)
def test_the_tip_stays_on_its_line_and_the_base_obeys_its_constraint(base, rule):
    start, rules = arch(ARM), Rules(base=base, redundancy=rule)
    limits, p = joint_limits(ARM), ARM.vector()
    paths = good_paths(rules)
    for direction, distance in zip(paths.direction, paths.distance, strict=True):
        s = np.linspace(0.0, distance - 1e-3, 12)  # other steps may end it 1 mm before
        q = on_the_way(start, direction, s, rules)
        assert_allclose(complex_tip(ARM, q), paths.tip + s * np.exp(1j * direction), atol=1e-6)
        assert (q[:, 3:] >= limits[:, 0] - 1e-12).all()
        assert (q[:, 3:] <= limits[:, 1] + 1e-12).all()
        if base == FIXED:
            assert_allclose(q[:, :3], np.broadcast_to(start[:3], (12, 3)), atol=0.0)
            continue
        assert_allclose(system_com(p, q), np.broadcast_to(system_com(p, start), (12, 2)), atol=1e-6)
        if base == ZERO_REACTION:
            assert_allclose(q[:, 2], start[2], atol=1e-9)


@pytest.mark.parametrize("base", [FLOATING, ZERO_REACTION])
@pytest.mark.parametrize("rule", RULES)
def test_the_motion_has_no_momentum(base, rule):
    """Rates are 4th-order differences, away from limits and singularities."""
    start, rules = arch(ARM), Rules(base=base, redundancy=rule)
    limits, h, seen = joint_limits(ARM), 1e-3, 0
    paths = good_paths(rules)
    for direction, distance in zip(paths.direction, paths.distance, strict=True):
        for share in (0.1, 0.5, 0.9):
            s = share * distance + h * np.arange(-2.0, 3.0)
            if s[0] < 0.0 or s[-1] > distance - 1e-3:
                continue
            q = on_the_way(start, direction, s, rules)
            held = np.minimum(q[:, 3:] - limits[:, 0], limits[:, 1] - q[:, 3:]) < 1e-2
            slope = (q[0] - 8.0 * q[1] + 8.0 * q[3] - q[4]) / (12.0 * h)
            if held.any() or np.abs(slope).max() > 10.0:
                continue
            assert_allclose(momentum(ARM.vector(), q[2], slope), 0.0, atol=1e-4)  # found: 2e-5
            seen += 1
    assert seen > 4  # of some 15 places, those that no kink is near


@pytest.mark.slow
@pytest.mark.parametrize("base", BASES)
@pytest.mark.parametrize("rule", RULES)
def test_half_the_step_gives_the_same_distances(base, rule):
    rules = Rules(base=base, redundancy=rule)
    full = straight_paths(ARM, arch(ARM), AROUND, rules)
    half = straight_paths(ARM, arch(ARM), AROUND, replace(rules, step=0.5 * rules.step))
    change = np.abs(full.distance - half.distance)[~(full.grazes | half.grazes)]
    assert change.max() < 1e-3
    assert len(change) > 0.7 * len(AROUND)


def test_the_reason_agrees_with_the_last_state():
    paths = straight_paths(ARM, arch(ARM), AROUND, Rules(base=FLOATING))
    limits = joint_limits(ARM)
    near = np.minimum(paths.last[:, 3:] - limits[:, 0], limits[:, 1] - paths.last[:, 3:]) < 1e-9
    reasons = [REASONS[k] for k in paths.reason]
    all_but_one = near.sum(axis=1) >= ARM.n - 1
    assert set(reasons) == {"all joints but one at their limits", "a singularity"}
    assert [r == "all joints but one at their limits" for r in reasons] == all_but_one.tolist()


def test_the_table_ends_paths():
    rules = Rules(base=FIXED, table_corners=(-0.1, -0.2, 1.2, 1.0))
    paths = straight_paths(ARM, arch(ARM), AROUND, rules)
    ended = [REASONS[k] == "the end of the table" for k in paths.reason]
    x, y = paths.ends.real, paths.ends.imag
    edges = np.min([x + 0.1, y + 0.2, 1.2 - x, 1.0 - y], axis=0)
    assert_allclose(edges[ended], 0.0, atol=1e-9)
    assert 0 < np.sum(ended) < len(ended)
    assert (edges > -1e-9).all()


@pytest.mark.parametrize("base", BASES)
def test_no_path_runs_past_a_singularity(base):
    """Nor does it leave the reachable workspace."""
    region, radius = fixed_workspace(ARM), VirtualManipulator(ARM).radius
    for start in random_starts(ARM, 8, np.random.default_rng(5)):
        paths = straight_paths(ARM, start, AROUND[::3], Rules(base=base))
        assert_allclose(complex_tip(ARM, paths.last), paths.ends, atol=1e-6)
        inner = paths.tip + (1.0 - 1e-6) * (paths.ends - paths.tip)
        if base == FIXED:
            assert region.contains(inner).all()
        else:
            com = complex(*system_com(ARM.vector(), paths.start))
            assert (np.abs(inner - com) < radius + 1e-6).all()


@pytest.mark.parametrize(
    ("q", "direction", "base", "rule"),
    [
        ((1.3222, -0.1957, 0.3939, -0.0753), 0.17453, FIXED, AWAY_FROM_LIMITS),
        ((0.0, 0.0, 0.0, 0.0), 1.93732, FIXED, WEIGHTED),
    ],
)
def test_a_sudden_singularity_is_found_as_with_small_steps(q, direction, base, rule):
    start, rules = np.array([0.0, 0.0, 0.0, *q]), Rules(base=base, redundancy=rule)
    path = straight_paths(ARM, start, direction, rules)
    fine = straight_paths(ARM, start, direction, replace(rules, step=1e-4))
    assert REASONS[path.reason[0]] == REASONS[fine.reason[0]] == "a singularity"
    assert_allclose(path.distance, fine.distance, atol=1e-4)
    assert_allclose(complex_tip(ARM, path.last), path.ends, atol=1e-6)


def test_the_weighted_rule_treats_both_limits_alike():
    base = replace(ARM.base, mount=(0.2, 0.0, 0.0))
    arm = replace(ARM, base=base, links=tuple(replace(link, theta_0=0.0) for link in ARM.links))
    start = np.array([0.0, 0.0, 0.0, 0.5 * np.pi, -0.5, -0.5, -0.5])
    rules, around = Rules(redundancy=WEIGHTED), AROUND[1:36:3]
    upper = straight_paths(arm, start, around, rules)
    lower = straight_paths(arm, -start, -around, rules)
    assert_allclose(lower.distance, upper.distance, rtol=0.0, atol=1e-10)


@pytest.mark.parametrize(("n", "base"), [(1, FIXED), (1, FLOATING), (2, ZERO_REACTION)])
def test_too_few_joints_are_a_singularity(n, base):
    arm = random_arm(n, np.random.default_rng(n))
    paths = straight_paths(arm, arch(arm), AROUND, Rules(base=base))
    assert (paths.distance == 0.0).all()
    assert {REASONS[k] for k in paths.reason} == {"a singularity"}


@pytest.mark.parametrize(
    ("n", "limits"), [(1, (-3.0, -1.0)), (4, (0.2, 0.3)), (12, (-np.pi / 2, np.pi / 2))]
)
def test_the_arch_is_within_the_limits(n, limits):
    low, high = limits
    arm = replace(ARM, links=(replace(ARM.links[0], q_min=low, q_max=high),) * n)
    q = arch(arm)[3:]
    assert (low < q).all()
    assert (q < high).all()
    if high == -low:
        straight_paths(arm, arch(arm), 0.0)  # that of a long arm is on the table


def test_the_boundary_is_accurate_between_its_directions():
    rules = Rules(base=FLOATING)
    paths = straight_workspace(ARM, arch(ARM), rules, count=90, tolerance=0.01)
    assert (np.diff(paths.direction) > 0.0).all()
    gaps = np.diff(paths.direction, append=paths.direction[0] + 2.0 * np.pi)
    wide = np.flatnonzero(gaps > 2e-4)
    share = np.random.default_rng(0).random(len(wide))
    between = straight_paths(ARM, arch(ARM), paths.direction[wide] + share * gaps[wide], rules)
    ends = paths.distance[wide], np.roll(paths.distance, -1)[wide]
    assert (np.abs(between.distance - ((1 - share) * ends[0] + share * ends[1])) < 0.03).all()
    finer = straight_workspace(ARM, arch(ARM), rules, count=360, tolerance=0.002)
    assert paths.area == pytest.approx(finer.area, rel=0.01)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("base", BASES)
def test_nothing_is_divided_by_zero(base):
    for rule in (MINIMUM_NORM, AWAY_FROM_LIMITS, WEIGHTED):
        for arm in (ARM, replace(ARM, links=ARM.links[:1])):
            straight_paths(arm, arch(arm), AROUND, Rules(base=base, redundancy=rule))


def test_a_free_base_shortens_paths_as_in_the_paper():
    areas = [straight_workspace(ARM, arch(ARM), Rules(base=b), count=90).area for b in BASES]
    assert areas[0] > 4.0 * areas[1] > 8.0 * areas[2] > 0.0


@pytest.mark.parametrize(
    ("n", "base"), [(2, FLOATING), (3, FLOATING), (3, ZERO_REACTION), (6, FLOATING)]
)
def test_other_numbers_of_links(n, base):
    """Also without redundancy, two joints afloat or three without reaction, past no singularity."""
    rules = Rules(base=base, table_corners=(-9.0, -9.0, 9.0, 9.0))
    longest = 0.0
    for seed in range(3):
        rng = np.random.default_rng(seed)
        arm = random_arm(n, rng)
        for start in (arch(arm), *random_starts(arm, 2, rng)):
            paths = straight_paths(arm, start, AROUND[::3], rules)
            longest = max(longest, paths.distance.max())
            assert_allclose(complex_tip(arm, paths.last), paths.ends, atol=1e-6)
            com = np.broadcast_to(system_com(arm.vector(), start), (len(paths.direction), 2))
            assert_allclose(system_com(arm.vector(), paths.last), com, atol=1e-6)
    assert longest > 0.1


@pytest.mark.parametrize(
    ("start", "rules", "error"),
    [
        (np.zeros(6), {}, "expected 7 finite numbers"),
        (np.array([0, 0, 0, 2.0, 0, 0, 0]), {}, "joint 1 starts at 114.6 deg, expected -90 to"),
        (np.array([3.0, 0, 0, 0, 0, 0, 0]), {}, "expected on the table"),
        (arch(ARM), {"base": "moon"}, "base is 'moon', expected one of fixed, floating"),
        (arch(ARM), {"step": 0.0}, "step is 0.0 m, expected a positive number"),
    ],
)
def test_invalid_arguments_are_rejected(start, rules, error):
    with pytest.raises(ValueError, match=error):
        straight_paths(ARM, start, AROUND, Rules(**rules))
