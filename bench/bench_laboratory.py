"""Consistency of calibrations with realistic joints (python bench/bench_laboratory.py [SEEDS]).

For each seed, the experiment of scripts/demo.sh without ROS, with the presets `default` and
`laboratory`: thirteen rests, and the moves between them. The same readings and poses are used for

    poses      all lengths and angles, weighted by the pose errors of a rest (1 mm, 0.1 deg)
    readings   as poses, with the errors of encoders and gears in the weights: at most 150 arc
               seconds of ripple, 60 of eccentricity
    cameras    b, I and the base's I and center of mass; everything else has random errors of the
               deviations in DynamicSettings, different for each seed; weighted by the cameras'
               white noise only (0.3 mm, 0.05 deg, 100 Hz)
    dynamic    as cameras, with a margin for the joints (0.5 mm, 0.1 deg, 100 Hz)

NEES is the normalized squared error per parameter: 1 is consistent, above 1.3 is overconfident.
Also printed: the largest error in standard deviations, root mean square errors, and how many
calibrations pass.
"""

import os
import sys
from dataclasses import replace
from math import radians
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "test" / "support"))
from sim_rehearsal import DYNAMIC, Rehearsal

from fss_arm_calib.acceptance import PASS
from fss_arm_calib.dynamic.calibrate import calibrate as calibrate_dynamics
from fss_arm_calib.kinematic.calibrate import calibrate
from fss_arm_calib.kinematic.settings import KinematicSettings
from fss_arm_model.layout import kinematic_index
from fss_arm_model.parameters import parameter_names, values

ROOT = Path(__file__).parents[1]
KINEMATIC = KinematicSettings(
    parametrization="full", position_deviation=0.001, heading_deviation=radians(0.1)
)
READINGS = replace(
    KINEMATIC,
    ripple_deviation=radians(150 / 3600) / 2.0**0.5,
    eccentricity_deviation=radians(60 / 3600) / 2.0**0.5,
)
CAMERAS = replace(DYNAMIC, position_deviation=0.0003, heading_deviation=radians(0.05))
MAX_NEES = 1.3


def draw_guess(truth, rng):
    """Return the description of an arm with random errors of the stated deviations."""
    n = truth.n
    off = DYNAMIC.deviations(n) * rng.standard_normal(5 * n + 6)
    off[3 * n + 6 :] = rng.uniform(-1.0, 1.0, 2 * n) * np.repeat([0.015, 0.01], n)  # b, I
    v = values(truth) + off
    base = replace(truth.base, mass=v[0], inertia=v[1], com=tuple(v[2:4].tolist()))
    mass, b, inertia = v[2 * n + 6 :].reshape(3, n).tolist()
    arm = replace(truth, base=base).with_kinematics(v[4 : 2 * n + 6].tolist())
    links = [
        replace(link, mass=mass[i], b=b[i], inertia=inertia[i]) for i, link in enumerate(arm.links)
    ]
    return replace(arm, links=tuple(links))


def score(outcome, error):
    """Return NEES, largest error in deviations, errors, and whether the calibration passed."""
    covariance = np.asarray(outcome.covariance).reshape(2 * (len(outcome.values),))
    covariance = covariance[: len(error), : len(error)]
    nees = error @ np.linalg.solve(covariance, error) / len(error)
    largest = np.abs(error / np.sqrt(np.diag(covariance))).max()
    return nees, largest, error, outcome.verdict == PASS


def kinematic(run, settings):
    outcome = calibrate(run.observations, run.guess, settings, run.finder.streams())
    error = np.array(outcome.values) - run.truth.vector()[kinematic_index(4)]
    angles = np.array(outcome.estimate.units) == "rad"
    error[angles] = (error[angles] + np.pi) % (2.0 * np.pi) - np.pi
    return score(outcome, error)


def dynamic(run, seed, settings):
    guess = draw_guess(run.truth, np.random.default_rng(seed))
    outcome = calibrate_dynamics(run.maneuvers, guess, settings, run.maneuver_finder.streams())
    chosen = [name for name in outcome.estimate.names if not name.startswith("g_")]
    true = dict(zip(parameter_names(4), values(run.truth), strict=True))
    return score(outcome, np.array(outcome.values)[: len(chosen)] - [true[name] for name in chosen])


def print_row(preset, kind, results, columns):
    nees, largest, errors, passed = zip(*results, strict=True)
    rms = np.sqrt(np.mean(np.square(errors), axis=0))
    errors_text = ", ".join(
        f"{name} {scale * np.sqrt(np.mean(rms[at] ** 2)):.2g} {unit}"
        for name, at, scale, unit in columns
    )
    mean, error = np.mean(nees), np.std(nees) / np.sqrt(len(nees))
    warning = "" if mean <= MAX_NEES else "  OVERCONFIDENT"
    print(
        f"{preset:10} {kind:8} NEES {mean:5.2f} +- {error:.2f}  largest {np.max(largest):4.1f}  "
        f"passed {np.sum(passed)}/{len(passed)}  {errors_text}{warning}",
        flush=True,
    )


def main():
    seeds = range(1, 1 + int(sys.argv[1] if sys.argv[1:] else 50))
    os.nice(5)
    for preset in ("default", "laboratory"):
        results = []
        for seed in seeds:
            run = Rehearsal(ROOT / "config", seed=seed, preset=preset)
            run.run()
            results.append((
                kinematic(run, KINEMATIC), kinematic(run, READINGS),
                dynamic(run, seed, CAMERAS), dynamic(run, seed, DYNAMIC),
            ))  # fmt: skip
        by_kind = list(zip(*results, strict=True))
        degree = 180.0 / np.pi
        for kind, results in zip(("poses", "readings"), by_kind, strict=False):
            print_row(preset, kind, results, [
                ("a", slice(4), 1e3, "mm"), ("theta", [4, 5, 6, 9], degree, "deg"),
                ("mount", slice(7, 9), 1e3, "mm"),
            ])  # fmt: skip
        for kind, results in zip(("cameras", "dynamic"), by_kind[2:], strict=True):
            print_row(preset, kind, results, [
                ("b", slice(4), 1e3, "mm"), ("I", slice(4, 8), 1e3, "g m^2"),
                ("I_0", slice(8, 9), 1e3, "g m^2"), ("com_0", slice(9, 11), 1e3, "mm"),
            ])  # fmt: skip


if __name__ == "__main__":
    main()
