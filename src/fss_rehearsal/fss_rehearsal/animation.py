"""Animation of a mission for the browser: an HTML fragment with its data, for a report."""

import json

import numpy as np

from fss_arm_model.description import Arm
from fss_arm_model.kinematics import joint_positions
from fss_arm_view.page import drawing_script

FRAMES = 10.0  # maximum frame rate [1/s]


def animation(
    arm: Arm,
    time: np.ndarray,
    q: np.ndarray,
    target: np.ndarray,
    holds: np.ndarray,
    valves: np.ndarray,
    phases: list[tuple[float, str]],
    fixture: tuple[float, ...],
) -> str:
    """Return HTML that animates base, arm, target and thrusters from above, with time controls.

    Args:
        arm: the arm.
        time: (k,) ascending [s].
        q: (k, 3 + n) base pose [m, m, rad] and true joint angles [rad].
        target: (k, 3) pose of the target [m, m, rad].
        holds: (k,) True where the gripper holds the target.
        valves: (k, 8) True for open thrusters, numbered as in ThrusterCommand.
        phases: start time [s] and name of each phase.
        fixture: grasp fixture in the target's frame [m, m, ...].
    """
    # First row of each frame; a valve counts as open if it is open in any row of the frame.
    steps = np.floor((time - time[0]) * FRAMES).astype(int)
    rows = np.flatnonzero(np.diff(steps, prepend=-1))
    fired = np.logical_or.reduceat(valves.astype(bool), rows, axis=0)
    p = arm.vector()
    data = {
        "time": np.round(time[rows] - time[0], 2).tolist(),
        "base": np.round(q[rows, :3], 4).tolist(),
        "arm": [np.round(joint_positions(p, q[row]), 3).tolist() for row in rows],
        "target": np.round(target[rows], 4).tolist(),
        "holds": [int(held) for held in holds[rows]],
        "fired": [np.flatnonzero(open_).tolist() for open_ in fired],
        "phases": [[round(since - float(time[0]), 2), phase] for since, phase in phases],
        "fixture": list(fixture[:2]),
    }
    text = json.dumps(data, separators=(",", ":")).replace("</", "<\\/")
    return TEMPLATE.replace("DRAWING", drawing_script(), 1).replace("DATA", text, 1)


TEMPLATE = """<h2>Animation of the mission</h2>
<style>
#film { max-width: 36rem; }
#film > canvas { width: 100%; aspect-ratio: 1; display: block; font-size: 0.85rem; }
#film p { display: flex; gap: 0.8rem; align-items: center; margin: 0.4rem 0; }
#film ul { list-style: none; display: flex; flex-wrap: wrap; gap: 0 1rem; margin: 0; padding: 0;
  font-size: 0.85rem; }
#film li { display: flex; align-items: center; gap: 0.4rem; }
#film input { flex: 1; } #film output { font-weight: 600; font-variant-numeric: tabular-nums; }
#film button { width: 5rem; font: inherit; }
</style>
<div id="film">
<canvas></canvas><ul></ul>
<p><button>Play</button><input type="range" min="0" value="0" step="0.1" aria-label="time">
<select aria-label="speed"><option value="1">1 x</option><option value="2">2 x</option>
<option value="5" selected>5 x</option><option value="10">10 x</option></select></p>
<p><output></output></p>
</div>
<script>
DRAWING
(() => {
  const d = DATA;
  const film = document.getElementById("film"), get = name => film.querySelector(name);
  const canvas = get("canvas"), slider = get("input"), button = get("button");
  const speed = get("select"), caption = get("output"), last = d.time.at(-1);
  let now = 0, playing = false, before = 0;
  slider.max = last;
  tableDrawing.legend(get("ul"), ["base", "target", "jet", "base_path", "tip_path", "target_path"]);

  const index = () => {  // of the last frame that has started
    let low = 0, high = d.time.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (d.time[middle] <= now) low = middle; else high = middle - 1;
    }
    return low;
  };

  function draw() {
    const k = index(), past = rows => rows.slice(0, k + 1);
    tableDrawing.table(canvas, {
      paths: {
        base_path: [past(d.base)], target_path: [past(d.target)],
        tip_path: [past(d.arm).map(points => points.at(-1))],
      },
      targets: [{pose: d.target[k], fixture: d.fixture}],
      vehicles: [{pose: d.base[k], joints: d.arm[k], fired: d.fired[k]}],
    });
    const phase = d.phases.filter(([since]) => since <= now).at(-1);
    caption.textContent = `${now.toFixed(1)} of ${last.toFixed(1)} s` +
      (phase ? `, ${phase[1]}` : "") + (d.holds[k] ? ", target held" : "");
    slider.value = now;
  }
  function frame(stamp) {
    if (!playing) return;
    now = Math.min(last, now + Math.min(0.2, (stamp - before) / 1000) * speed.value);
    before = stamp;
    draw();
    if (now < last) requestAnimationFrame(frame); else play(false);
  }
  function play(on) {
    playing = on;
    button.textContent = on ? "Pause" : "Play";
    if (!on) return;
    if (now >= last) now = 0;
    before = performance.now();
    requestAnimationFrame(frame);
  }
  button.onclick = () => play(!playing);
  addEventListener("resize", draw);
  slider.oninput = () => { play(false); now = Number(slider.value); draw(); };
  draw();
})();
</script>"""
