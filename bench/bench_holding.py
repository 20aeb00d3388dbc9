"""The vehicle held fixed: its thrusters keep the base in place while the arm goes through postures.

By nodes alone, on the simulated test bed with its default errors.

    . scripts/env.sh; python bench/bench_holding.py             # --no-feed-forward beside it

Prints for each posture how far the base was from its pose on the way there and in the rest after
it, and the propellant used so far. Exits with 1 if it was ever farther than 1 cm or 1 degree.
"""

import argparse
import sys
from pathlib import Path
from tempfile import mkdtemp

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "test/support"))
from running import OWN  # enters a ROS domain of its own: before rclpy

import rclpy  # isort: skip
from flight import Flyer, start  # isort: skip

from fss_arm_calib.experiment.postures import default
from fss_arm_model.description import paper_arm
from fss_rehearsal.processes import Nodes

# Of a computer that does other things, too.
PATIENT = {"timeout": 4.0, "watchdog": 4.0}
AGE = {"max_age": 2.0}


def fly(flyer: Flyer, duration: float, rest: float, count: int) -> bool:
    """Go through the postures; whether the base was held."""
    flyer.begin()
    handle = flyer.holding()
    flyer.pass_time(5.0, timeout=600.0)
    here, worst = np.array(flyer.truths[-1].q[:3]), np.zeros(2)
    begun = flyer.truths[-1].propellant
    for k, q in enumerate(default(paper_arm())[:count], 1):
        since = flyer.t
        ended = flyer.does("arm/move", q=q.tolist(), duration=duration, timeout=3600.0)
        flyer.pass_time(rest, timeout=3600.0)
        off = np.array(flyer.off(here, since))
        worst = np.maximum(worst, off)
        used = flyer.truths[-1].propellant - begun
        print(
            f"posture {k:2}: {1e3 * off[0]:6.2f} mm  {off[1]:6.3f} deg  {1e3 * used:5.1f} g"
            f"  {'' if ended.result.reached else ended.result.message}",
            flush=True,
        )
        if flyer.states[-1].phase != "hold":
            print(f"no longer held: {flyer.states[-1].reason}")
            return False
    flyer.after(handle.cancel_goal_async())
    result = flyer.end(handle).result
    print(f"in all: {1e3 * worst[0]:.2f} mm, {worst[1]:.3f} deg, {1e3 * result.propellant:.1f} g "
          f"by base/propellant")  # fmt: skip
    return bool(worst[0] < 0.01 and worst[1] < 1.0)


def main() -> int:
    """Start the graph and fly."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--duration", type=float, default=120.0, help="of each move [s]")
    parser.add_argument("--rest", type=float, default=6.0, help="after each move [s]")
    parser.add_argument("--postures", type=int, default=13, help="how many of them")
    parser.add_argument("--speed", type=float, default=1.0, help="of the simulated time")
    parser.add_argument("--no-feed-forward", action="store_true")
    parser.add_argument("--bandwidth", type=float, default=0.35, help="of the control [rad/s]")
    given = parser.parse_args()
    rclpy.init()
    logs = Path(mkdtemp(prefix="bench_holding_"))
    with Nodes(logs, print, OWN) as nodes:
        control = {"feed_forward": not given.no_feed_forward, "bandwidth": given.bandwidth, **AGE}
        start(nodes, given.speed, base=PATIENT, control=control, guidance=AGE)
        flyer = Flyer(nodes)
        try:
            held = fly(flyer, given.duration, given.rest, given.postures)
        finally:
            flyer.close()
    return int(not held)


if __name__ == "__main__":
    sys.exit(main())
