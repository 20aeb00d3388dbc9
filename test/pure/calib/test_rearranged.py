"""Links moved to other places of the arm: what is known of them follows, and is right there."""

from dataclasses import replace

import numpy as np
import pytest
from calib_joint import KINEMATIC
from sim_rehearsal import DYNAMIC, Rehearsal

from fss_arm_calib import result
from fss_arm_calib.acceptance import PASS
from fss_arm_calib.dynamic.calibrate import calibrate as calibrate_dynamics
from fss_arm_calib.kinematic.calibrate import calibrate
from fss_arm_calib.links import main
from fss_arm_model.description import paper_arm
from fss_arm_model.description_file import from_yaml, load, save
from fss_arm_model.parameters import parameter_names, values
from fss_rehearsal.dynamic import draw_truth

BEFORE, AFTER = (7, 8, 9, 10), (8, 7, 10, 9)


def named(arm):
    links = zip(arm.links, BEFORE, strict=True)
    return replace(arm, links=tuple(replace(link, serial=k) for link, k in links))


def rearranged(arm):
    """The same links at other places; the first one's offset is the mount's."""
    every = {link.serial: link for link in arm.links}
    first, *others = (every[k] for k in AFTER)
    x, y, angle = arm.base.mount
    base = replace(arm.base, mount=(x, y, angle + first.theta_0))
    return replace(arm, base=base, links=(replace(first, theta_0=0.0), *others))


def experiment(truth, arm, seed):
    """Rests and the maneuvers between, on the simulated test bed, and the kinematics by them."""
    run = Rehearsal(arms=(truth, arm), seed=seed, preset="default")
    run.run()
    found = calibrate(run.observations, arm, KINEMATIC, run.finder.streams())
    assert found.verdict == PASS, found.reason
    return run, from_yaml(found.description)


def dynamics(run, arm, settings=DYNAMIC):
    found = calibrate_dynamics(run.maneuvers, arm, settings, run.maneuver_finder.streams())
    assert found.verdict == PASS, found.reason
    return found


def of_links(arm):
    """What is known of each link by serial number: value and deviation by name."""
    names = parameter_names(arm.n)
    sigma = np.sqrt(np.diag(arm.known.covariance_of(names, np.full(len(names), np.nan))))
    found = {}
    for name, value, deviation in zip(names, values(arm), sigma, strict=True):
        stem, _, place = name.rpartition("_")
        if place.isdigit() and place != "0":
            found[stem, arm.links[int(place) - 1].serial] = value, deviation
    return found


def errors(outcome, truth):
    """Of what is estimated of arm and base, in its deviations."""
    true = dict(zip(parameter_names(truth.n), values(truth), strict=True))
    rows = zip(outcome.names, outcome.values, outcome.deviations, strict=True)
    return np.array([(x - true[name]) / sigma for name, x, sigma in rows if name in true])


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_links_moved_to_other_places_agree_with_what_was_written_back(tmp_path, seed):
    file, told = tmp_path / "arm.yaml", tmp_path / "result.json"
    truth = named(draw_truth(paper_arm(), DYNAMIC, seed))
    save(named(paper_arm()), file)
    run, arm = experiment(truth, load(file), seed)
    result.write(told, "dynamic", dynamics(run, arm))
    assert main([str(file), "--result", str(told)]) == 0
    before = of_links(load(file))

    file.write_text(file.read_text().replace(str([*BEFORE]), str([*AFTER])))
    moved = load(file)
    followed = of_links(moved)
    unlike = {("theta_0", 7)}  # of the link that was first nobody knew it
    assert all(followed[k] == before[k] for k in followed.keys() & before.keys() - unlike)
    run, arm = experiment(rearranged(truth), moved, seed + 10)
    alone = dynamics(run, arm)
    after = of_links(from_yaml(alone.description))
    apart = {
        k: (after[k][0] - before[k][0]) / np.hypot(after[k][1], before[k][1])
        for k in after.keys() & before.keys() - unlike
        if k[0] != "m"  # which the scale told of both
    }
    assert len(apart) == 4 + 2 + 4 + 4  # a, theta_0, b, I
    assert max(map(abs, apart.values())) < 3.5

    together = dynamics(run, arm, replace(DYNAMIC, told=True))
    b = [together.names.index(f"b_{i}") for i in range(1, 5)]
    assert (together.deviations[b] < alone.deviations[b]).all()
    assert np.mean(together.deviations[b] / alone.deviations[b]) < 0.85
    assert np.abs(errors(together, rearranged(truth))).max() < 3.5
