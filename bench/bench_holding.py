"""Holding the base: thrusters keep the base in place while the arm moves through postures.

All nodes run on the simulated test bed with its default errors.

    . scripts/env.sh; python bench/bench_holding.py [--no-feed-forward]

Prints for each posture the largest error of the base during the move and the rest after it, and the
propellant used since the start. Exits with 1 if an error exceeded 1 cm or 1 degree.
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

from fss_arm_calib.experiment.postures import default_postures
from fss_arm_model.description import paper_arm
from fss_rehearsal.processes import Nodes

# For a busy computer.
LONG_TIMEOUTS = {"timeout": 4.0, "watchdog": 4.0}
MAX_AGE = {"max_age": 2.0}


def fly(flyer: Flyer, duration: float, rest: float, count: int) -> bool:
    """Move through the postures; return True if the base was held."""
    flyer.begin()
    handle = flyer.holding()
    flyer.pass_time(5.0, timeout=600.0)
    pose, worst = np.array(flyer.truths[-1].q[:3]), np.zeros(2)
    initial = flyer.truths[-1].propellant
    for k, q in enumerate(default_postures(paper_arm())[:count], 1):
        start = flyer.t
        move = flyer.does("arm/move", q=q.tolist(), duration=duration, timeout=3600.0)
        flyer.pass_time(rest, timeout=3600.0)
        off = np.array(flyer.off(pose, start))
        worst = np.maximum(worst, off)
        propellant = flyer.truths[-1].propellant - initial
        print(
            f"posture {k:2}: {1e3 * off[0]:6.2f} mm  {off[1]:6.3f} deg  {1e3 * propellant:5.1f} g"
            f"  {'' if move.result.reached else move.result.message}",
            flush=True,
        )
        if flyer.states[-1].phase != "hold":
            print(f"the base is no longer held: {flyer.states[-1].reason}")
            return False
    flyer.after(handle.cancel_goal_async())
    result = flyer.end(handle).result
    print(
        f"largest errors: {1e3 * worst[0]:.2f} mm, {worst[1]:.3f} deg, "
        f"{1e3 * result.propellant:.1f} g by base/propellant"
    )
    return bool(worst[0] < 0.01 and worst[1] < 1.0)


def main() -> int:
    """Start the nodes and run the postures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--duration", type=float, default=120.0, help="of each move [s]")
    parser.add_argument("--rest", type=float, default=6.0, help="after each move [s]")
    parser.add_argument("--postures", type=int, default=13, help="number of postures")
    parser.add_argument(
        "--speed", type=float, default=1.0, help="of the simulation, in multiples of real time"
    )
    parser.add_argument("--no-feed-forward", action="store_true")
    parser.add_argument("--bandwidth", type=float, default=0.35, help="of the control [rad/s]")
    options = parser.parse_args()
    rclpy.init()
    logs = Path(mkdtemp(prefix="bench_holding_"))
    with Nodes(logs, print, OWN) as nodes:
        control = {
            "feed_forward": not options.no_feed_forward,
            "bandwidth": options.bandwidth,
            **MAX_AGE,
        }
        start(nodes, options.speed, base=LONG_TIMEOUTS, control=control, guidance=MAX_AGE)
        flyer = Flyer(nodes)
        try:
            holds = fly(flyer, options.duration, options.rest, options.postures)
        finally:
            flyer.close()
    return int(not holds)


if __name__ == "__main__":
    sys.exit(main())
