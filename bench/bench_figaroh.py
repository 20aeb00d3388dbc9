"""Comparison of our kinematic calibration with FIGAROH (python bench/bench_figaroh.py DIR PYTHON).

DIR is a data set of `scripts/dataset.sh`, PYTHON that of an environment with `pip install figaroh`.
FIGAROH gets the rests of plain least squares, ours finds its own in the same bag. FIGAROH estimates
what it chooses (`structural`: 2 n + 3, with the end effector's heading offset), all placements with
priors as large as a description's errors (`map`), or what ours does (`our columns`), converted to
lengths, joint offsets and mount. It passes if its solver does. The prediction's error is that of
the end effector's position in the base against the true arm, RMS in random postures.
"""

import json
import subprocess
import sys
from collections import defaultdict
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np

DEVIATIONS = {"position": 0.002, "orientation": 0.0025}  # of both subjects and the base's heading
SET_UP = {"known_baseframe": True, "known_tipframe": False, "measurement_std": DEVIATIONS}
PRIORS = {"translation": 0.003, "rotation": 0.03, "joint_offset": 0.03}  # largest / sqrt(3)
METHODS = {"structural": {}, "map": {"method": "map", "priors": PRIORS}, "our columns": {}}
TASK = {  # of FIGAROH; measured are x, y and heading
    "kinematics": {"tool_frame": "end_effector"},
    "measurements": {"markers": [{"measurable_dof": [True, True, False, False, False, True]}]},
}


def solve_all(folder):
    """Write results of each case in a folder; runs in the Python that has FIGAROH."""
    from figaroh.calibration import BaseCalibration
    from figaroh.tools.robot import load_robot

    for case, method in product(sorted(folder.iterdir()), METHODS):
        begin = perf_counter()
        one = BaseCalibration(load_robot(f"{case}/arm.urdf"), f"{case}/config.yaml")
        (set_up := one.calib_config).update(SET_UP, estimation=METHODS[method])
        one.initialize()
        if method == "our columns":
            own = [f"d_{k}_{joint}" for joint in one.model.names[1:] for k in ("px", "phiz")]
            set_up["param_name"] = [*own, "d_py_joint_1", "pEEx_1"]
        x, jacobian = one.solve(enable_logging=False).x, one.LM_result.jac
        covariance = np.linalg.inv(jacobian.T @ jacobian)
        covariance *= one.std_dev[0] ** 2 / covariance[0, 0]
        found = one.STATUS == "CALIBRATED", perf_counter() - begin, set_up["param_name"]
        (case / f"{method}.json").write_text(json.dumps([*found, x.tolist(), covariance.tolist()]))


def converted(x, names, start):
    """Return the parameters of `kinematic_names` from FIGAROH's, whose frames may be turned."""
    n, at = len(start) // 2 - 1, defaultdict(float, zip(names, x, strict=True))
    moves = [at[f"d_px_joint_{i + 1}"] + 1j * at[f"d_py_joint_{i + 1}"] for i in range(n)]
    steps = np.r_[complex(*start[-3:-1]), start[:n]] + [*moves, at["pEEx_1"] + 1j * at["pEEy_1"]]
    angles = start[[-1, *range(n, 2 * n - 1)]] + [at[f"d_phiz_joint_{i + 1}"] for i in range(n)]
    angles += np.diff(np.angle(steps[1:]), prepend=0.0)
    return np.r_[np.abs(steps[1:]), angles[1:], steps[0].real, steps[0].imag, angles[0]]


def main(data, python):
    from fss_arm_calib.from_bag import solve_bag
    from fss_arm_calib.kinds import KINDS
    from fss_arm_model.description_file import load
    from fss_arm_model.kinematics import tip_in_base
    from fss_arm_model.layout import kinematic_index, kinematic_names
    from fss_arm_model.urdf import urdf
    from fss_rehearsal.dataset import arms, bags, least_squares, results

    kind, found, cases = KINDS["kinematic"], [], {}

    def add(pair, preset, method, passed, seconds, *estimate):
        compared = results.compare(*estimate, results.true_values("kinematic", preset, pair.truth))
        one = results.Estimates("kinematic", preset, method, passed, seconds, *compared)
        found.append((one, pair.truth))

    ways = [*data.glob("truth/?.yaml"), *data.parent.glob(f"{data.name}_blind_truth/?.yaml")]
    with TemporaryDirectory() as folder:
        for preset, way in product(bags.USED_PRESETS, sorted(ways)):
            arm, bag = data / "arms" / way.name, data / "bags" / way.stem / preset / "kinematic"
            pair, begin = arms.ArmPair(load(way), load(arm)), perf_counter()
            own = solve_bag(kind, bag, kind.settings(arm=str(arm)), arm=pair.described)
            seconds, estimate = perf_counter() - begin, (own.names, own.values, own.deviations)
            add(pair, preset, results.OWN_METHOD, own.verdict == "pass", seconds, *estimate)
            found.append((results.evaluate_plain(bag, preset, pair), pair.truth))
            begin, n, read = perf_counter(), pair.truth.n, least_squares.read(bag)
            seen = least_squares.rests(read, "/vicon/fss/fss", "/vicon/end_effector/end_effector")
            names, start = kinematic_names(n), pair.described.vector()[kinematic_index(n)]
            straight = start * [not name.startswith("theta") for name in names]
            (case := Path(folder, f"{preset}_{way.stem}")).mkdir()
            (case / "arm.urdf").write_text(urdf(pair.described.with_kinematics(straight)))
            rows = np.c_[seen[0] + start[[-1, *range(n, 2 * n - 1)]], seen[1]]  # x along each link
            head = ",".join([*(f"joint_{i + 1}" for i in range(n)), "x1,y1,phiz1"])
            np.savetxt(case / "rests.csv", rows, delimiter=",", header=head, comments="")
            task = {"calibration": TASK | {"data": {"source_file": f"{case}/rests.csv"}}}
            (case / "config.yaml").write_text(json.dumps({"robot": {"name": n}, "tasks": task}))
            cases[case] = names, start, perf_counter() - begin, pair, preset
        subprocess.check_output([python, "-Wignore", __file__, folder])
        for (case, (names, start, reading, *key)), method in product(cases.items(), METHODS):
            passed, seconds, own, x, covariance = json.loads((case / f"{method}.json").read_text())
            values = converted(x, own, start)
            slopes = [converted(x + h, own, start) - values for h in 1e-6 * np.eye(len(x))]
            deviations = np.sqrt(np.diag(np.transpose(slopes) @ covariance @ slopes)) / 1e-6
            add(*key, f"FIGAROH, {method}", passed, reading + seconds, names, values, deviations)

    predicted = defaultdict(list)
    for one, truth in found:
        q = np.random.default_rng(1).uniform(-1.5, 1.5, (500, truth.n))
        moved = truth.with_kinematics(truth.vector()[kinematic_index(truth.n)] + one.errors)
        off = 1e3 * (tip_in_base(moved.vector(), q) - tip_in_base(truth.vector(), q))
        predicted[one.preset, one.method].append(np.sum(off[:, :2] ** 2, axis=1))
    head, *rows = results.results_table([one for one, _ in found])
    print("|", " | ".join([*head, "prediction [mm]"]), "|")
    for row in sorted(rows, key=lambda row: bags.USED_PRESETS.index(row[1])):
        print("|", " | ".join([*row, f"{np.sqrt(np.mean(predicted[row[1], row[2]])):.2g}"]), "|")


if __name__ == "__main__":
    solve_all(Path(sys.argv[1])) if len(sys.argv) == 2 else main(Path(sys.argv[1]), sys.argv[2])
