"""Age of the live page's drawing on a busy computer (bench/bench_view.py [SECONDS [FOLDER]]).

One busy loop per core, a simulated scene (poses at 100 Hz), the view, and a page in headless
Chromium without graphics card. For each width of the page, for SECONDS (default 600):

    age      time since the stamp of the newest measurement that is drawn, from measurement to the
             frame after the drawing; percentiles are over time, not over drawings

It ends with 1 if the age is above the limit at a width: 0.5 s (median), 1 s (99 %), 2 s (worst).
With FOLDER, a screenshot of each width is written there. It must be run as root or in a container
where Chromium needs no sandbox, and needs Debian's package chromium.
"""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

sys.path.append(str(Path(__file__).parents[1] / "test" / "support"))
import view_scene
from browser import Page
from running import DOMAIN, free_port

WIDTHS = 400, 1100, 1600  # [px]
HEIGHT = 1000  # [px]
LIMITS = 0.5, 1.0, 2.0  # of the age: median, 99 %, worst [s]
WARM_UP, START_TIMEOUT = 15.0, 120.0  # [s]
RECORD = """
window.drawings = [];
document.addEventListener("drawn", ({detail}) => requestAnimationFrame(() => setTimeout(
  () => drawings.push([Date.now() / 1000, detail.stamp]))));
"""


def ages(drawings: np.ndarray) -> tuple[float, float, float]:
    """Return the median, the 99th percentile and the maximum of the age over time [s].

    Args:
        drawings: (k, 2) time of each drawing, and the stamp that it shows [s].
    """
    if len(drawings) < 2:
        return np.inf, np.inf, np.inf
    at, stamp = drawings.T
    fresh, before_next = at[:-1] - stamp[:-1], at[1:] - stamp[:-1]
    over_time = [
        np.arange(a, b, 0.001) if b > a else [] for a, b in zip(fresh, before_next, strict=True)
    ]
    age = np.concatenate(over_time)
    return float(np.median(age)), float(np.percentile(age, 99.0)), float(before_next.max())


def start(*command: object) -> subprocess.Popen[str]:
    """Start a Python program in the ROS domain of this process."""
    return subprocess.Popen(
        [sys.executable, *map(str, command)],
        env=os.environ | {"ROS_DOMAIN_ID": str(DOMAIN)},
        stderr=subprocess.PIPE,
        text=True,
    )


def measure(url: str, width: int, seconds: float, folder: str) -> tuple[float, float, float]:
    """Return the ages of the drawing on a page of a width."""
    with TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        page = Page(url, Path(profile), (width, HEIGHT))
        try:
            deadline = time.monotonic() + START_TIMEOUT
            while not page.text("status").startswith("live"):
                if time.monotonic() > deadline:
                    raise TimeoutError(f"the page shows no data: {page.text('status')}")
                time.sleep(0.5)
            page.ask("Runtime.evaluate", expression=RECORD)
            page.resize(width, HEIGHT)
            time.sleep(WARM_UP)
            page.ask("Runtime.evaluate", expression="drawings.length = 0")
            time.sleep(seconds)
            found = page.ask("Runtime.evaluate", expression="drawings", returnByValue=True)
            if folder:
                Path(folder, f"view_{width}.png").write_bytes(page.picture())
        finally:
            page.close()
    return ages(np.array(found["result"]["value"]))


def main() -> int:
    """Print a table of ages; return 1 if one is above its limit."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 600.0
    folder = sys.argv[2] if len(sys.argv) > 2 else ""
    busy = [start("-c", "while True: pass") for _ in range(os.cpu_count() or 1)]
    code = "import sys; from fss_arm_view.view_node import main; sys.exit(main())"
    ports = "-p", f"port:={free_port()}", "-p", f"web_port:={free_port()}"
    view = start("-c", code, "--ros-args", *ports)
    others = [*busy, start(view_scene.__file__), view]
    is_late = False
    try:
        assert view.stderr
        address = next(found for line in view.stderr if (found := re.search(r"http://\S+", line)))
        print(" width    median    99 %   worst  age of the drawing [s]")
        for width in WIDTHS:
            age = measure(address[0], width, seconds, folder)
            is_late |= any(value > limit for value, limit in zip(age, LIMITS, strict=True))
            print(f"{width:6d}  {age[0]:8.3f}{age[1]:8.3f}{age[2]:8.3f}", flush=True)
    finally:
        for process in others:
            process.send_signal(signal.SIGINT if process is view else signal.SIGKILL)
            process.wait(30.0)
    print(
        f"limits  {LIMITS[0]:8.3f}{LIMITS[1]:8.3f}{LIMITS[2]:8.3f}", "FAIL" if is_late else "pass"
    )
    return int(is_late)


if __name__ == "__main__":
    sys.exit(main())
