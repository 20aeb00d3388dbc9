"""Animation of a mission for the browser: an HTML fragment with its data, without other files."""

import json

import numpy as np

from fss_arm_model.description import Arm
from fss_arm_model.kinematics import joint_positions

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
    return TEMPLATE.replace("DATA", text, 1)


TEMPLATE = """<h2>Animation of the mission</h2>
<style>
#film { max-width: 34rem; }
#film canvas { width: 100%; display: block; }
#film p { display: flex; gap: 0.8rem; align-items: center; margin: 0.4rem 0; }
#film input { flex: 1; } #film output { font-weight: 600; font-variant-numeric: tabular-nums; }
#film button { width: 5rem; font: inherit; }
</style>
<div id="film">
<canvas width="1000" height="1000"></canvas>
<p><button>Play</button><input type="range" min="0" value="0" step="0.1" aria-label="time">
<select aria-label="speed"><option value="1">1 x</option><option value="2">2 x</option>
<option value="5" selected>5 x</option><option value="10">10 x</option></select></p>
<p><output></output></p>
<p><small>Blue: base and arm; green: path of the end effector; purple: target; cyan: firing
thrusters. A gray square is 0.5 m wide, the frame is the table; x points right, y up.</small></p>
</div>
<script>
(() => {
  const d = DATA;
  const film = document.getElementById("film"), get = name => film.querySelector(name);
  const canvas = get("canvas"), c = canvas.getContext("2d"), slider = get("input");
  const button = get("button"), speed = get("select"), caption = get("output");
  const last = d.time.at(-1), HALF = 0.135, EDGE = 2.05, SCALE = canvas.width / (2 * EDGE);
  const CORNERS = [[1, 1], [-1, 1], [-1, -1], [1, -1]];
  let now = 0, playing = false, before = 0;
  slider.max = last;

  const line = (points, colour, width, close) => {
    c.beginPath();
    points.forEach(([x, y]) => c.lineTo(x, y));
    if (close) c.closePath();
    c.strokeStyle = colour; c.lineWidth = width; c.stroke();
  };
  const at = ([x, y, angle], draw) => {
    c.save(); c.translate(x, y); c.rotate(angle); draw(); c.restore();
  };
  const square = colour => line(CORNERS.map(([x, y]) => [HALF * x, HALF * y]), colour, 0.018, true);
  const index = () => {  // of the last frame that has started
    let low = 0, high = d.time.length - 1;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (d.time[middle] <= now) low = middle; else high = middle - 1;
    }
    return low;
  };

  function draw() {
    const k = index(), arm = d.arm[k];
    c.setTransform(1, 0, 0, 1, 0, 0);
    c.clearRect(0, 0, canvas.width, canvas.height);
    c.setTransform(SCALE, 0, 0, -SCALE, canvas.width / 2, canvas.height / 2);
    c.lineJoin = c.lineCap = "round";
    for (let v = -2; v <= 2; v += 0.5) {
      const colour = Math.abs(v) === 2 ? "#666" : "#e4e4e4";
      line([[v, -2], [v, 2]], colour, 0.006); line([[-2, v], [2, v]], colour, 0.006);
    }
    line(d.base.slice(0, k + 1), "#a9c5ea", 0.008);
    line(d.target.slice(0, k + 1), "#d5c0e4", 0.008);
    line(d.arm.slice(0, k + 1).map(points => points.at(-1)), "#1e9646", 0.008);
    at(d.target[k], () => {
      square("#9650be");
      line([[0, 0], d.fixture], "#9650be", 0.018);
    });
    at(d.base[k], () => {
      for (const jet of d.fired[k]) {
        const [i, j] = CORNERS[jet >> 1], x = HALF * i, y = HALF * j, far = 0.2, wide = 0.04;
        c.beginPath(); c.moveTo(x, y); c.fillStyle = "#00afbe";
        if (jet % 2) { c.lineTo(x - wide, y + far * j); c.lineTo(x + wide, y + far * j); }
        else { c.lineTo(x + far * i, y - wide); c.lineTo(x + far * i, y + wide); }
        c.fill();
      }
      square("#286ec8");
    });
    line([d.base[k], ...arm], "#286ec8", 0.022);
    for (const [x, y] of arm) {
      c.beginPath(); c.arc(x, y, 0.022, 0, 7); c.fillStyle = "#286ec8"; c.fill();
    }
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
  slider.oninput = () => { play(false); now = Number(slider.value); draw(); };
  draw();
})();
</script>"""
