// The live page: states arrive as server-sent events and are kept for a minute; the newest is drawn.
(() => {
  const DURATION = 60;  // of paths and headings [s]
  const MAX_AGE = 3;  // of data that count as live [s]
  const MAX_STEP = 1;  // backward step of stamps after which a recording starts again [s]
  const TABLE_LEGEND = ["base", "predicted", "target", "zone", "jet", "route", "base_path", "tip_path"];
  const {clear, color, label, legend, line, table} = tableDrawing;
  const get = id => document.getElementById(id);
  const samples = {};  // by name of the vehicle: states of the last minute, oldest first
  const delays = [];  // of the last states: time here at arrival, less the time they were sent [s]
  let newest = null, arrived = 0, connected = false, waiting = false, shown = "";

  function keep(vehicle) {
    const kept = samples[vehicle.name] ||= [], last = kept.at(-1);
    if (!vehicle.pose || (last && vehicle.t === last.t)) return;
    if (last && vehicle.t < last.t - MAX_STEP) kept.length = 0;
    const degrees = angle => angle * 180 / Math.PI;
    const wrap = angle => Math.atan2(Math.sin(angle), Math.cos(angle));
    const heading = vehicle.pose[2];
    vehicle.measured = kept.length ? kept.at(-1).measured + degrees(wrap(heading - kept.at(-1).pose[2]))
      : degrees(heading);
    vehicle.expected = vehicle.predicted
      ? vehicle.measured + degrees(wrap(vehicle.predicted[2] - heading)) : null;
    kept.push(vehicle);
    while (kept[0].t < vehicle.t - DURATION) kept.shift();
  }

  // Age of the newest data [s]; the shortest delay of the last minute stands for equal clocks.
  function age() {
    const delay = delays.at(-1) - Math.min(...delays);
    return newest.silent + delay + (performance.now() - arrived) / 1000;
  }

  function report() {
    let state = "good", text;
    if (!newest) [state, text] = ["danger", "NO CONNECTION to the view: its node starts, or has ended"];
    else if (age() > MAX_AGE) {
      state = "danger";
      text = connected ? `NO DATA FOR ${Math.round(age())} s: motion capture and joints are silent`
        : `NO DATA FOR ${Math.round(age())} s: the view does not answer`;
      if (!newest.stamp) [state, text] = ["attention", "waiting for the first pose or joint reading"];
    } else text = `live: data ${age().toFixed(1)} s old`;
    get("status").textContent = text;
    get("status").className = state;
    get("clock").textContent = `time here ${new Date().toLocaleTimeString("en-GB")}`;
  }

  function showStrips() {
    const text = JSON.stringify(newest.vehicles.map(({name, items}) => [name, items]));
    if (text === shown) return;  // changing the page costs more than drawing
    shown = text;
    get("strips").replaceChildren(...newest.vehicles.map(({name, items}) => {
      const list = document.createElement("dl");
      for (const [what, value, style] of name ? [["vehicle", name, ""], ...items] : items) {
        const item = document.createElement("div"), term = document.createElement("dt");
        const description = document.createElement("dd");
        item.className = style; term.textContent = what; description.textContent = value;
        item.append(term, description); list.append(item);
      }
      return list;
    }));
  }

  function drawTable() {
    const paths = {base_path: [], tip_path: [], route: []}, vehicles = [], targets = [];
    for (const vehicle of newest.vehicles) {
      const kept = samples[vehicle.name] || [];
      paths.base_path.push(kept.map(state => state.pose));
      paths.tip_path.push(kept.map(({tip, joints}) => tip || joints.at(-1)));
      if (vehicle.target) targets.push({pose: vehicle.target, radius: vehicle.keep_out});
      if (!vehicle.pose) continue;
      if (vehicle.route.length) paths.route.push([vehicle.pose, ...vehicle.route]);
      vehicles.push(vehicle);
    }
    table(get("table"), {paths, targets, vehicles});
    const phases = newest.vehicles.filter(({phase}) => phase);
    const words = phases.map(({name, phase}) => `${name} ${phase}`.trim());
    get("phase").textContent = words.length ? `\u2014 ${words.join("; ")}` : "";
  }

  function drawHeading(canvas, kept) {
    const [c, width, height] = clear(canvas), now = kept.at(-1).t;
    const left = 58, top = 8, right = width - 12, bottom = height - 40;
    const values = kept.flatMap(({measured, expected, sigma}) => expected === null ? [measured]
      : [measured, expected - (sigma || 0), expected + (sigma || 0)]);
    let low = Math.min(...values), high = Math.max(...values);
    const middle = (low + high) / 2, half = Math.max((high - low) * 0.55, 0.5);
    [low, high] = [middle - half, middle + half];
    const place = (t, value) => [right - (now - t) / DURATION * (right - left),
      bottom - (value - low) / (high - low) * (bottom - top)];
    const rough = (high - low) / 5, power = 10 ** Math.floor(Math.log10(rough));
    const step = [1, 2, 5, 10].find(m => m * power >= rough) * power;
    for (let k = Math.ceil(low / step); k * step <= high; k += 1) {
      const y = place(now, k * step)[1];
      line(c, [[left, y], [right, y]], "grid");
      const text = (k * step).toFixed(Math.max(0, -Math.floor(Math.log10(step))));
      label(c, text.replace("-", "\u2212"), [left - 4, y], "right", "middle");
    }
    for (let t = -DURATION; t <= 0; t += width < 500 ? 20 : 10) {
      const x = place(now + t, low)[0];
      line(c, [[x, top], [x, bottom]], "grid");
      label(c, `${t}`.replace("-", "\u2212"), [x, bottom + 3], "center");
    }
    label(c, "time [s], newest data at 0", [(left + right) / 2, height - 2], "center", "bottom");
    c.save(); c.translate(2, (top + bottom) / 2); c.rotate(-Math.PI / 2);
    label(c, "heading [deg]", [0, 0], "center"); c.restore();
    const known = kept.filter(({expected}) => expected !== null);
    c.fillStyle = color("band");
    known.slice(1).forEach((b, k) => {  // between successive states; a gap stays blank
      const a = known[k];
      if (b.t - a.t > 1 || a.sigma === null || b.sigma === null) return;
      c.beginPath();
      for (const [state, sign] of [[a, -1], [a, 1], [b, 1], [b, -1]])
        c.lineTo(...place(state.t, state.expected + sign * state.sigma));
      c.fill();
    });
    for (const [chosen, key, style] of [[known, "expected", "predicted"], [kept, "measured", "base"]]) {
      let piece = [];
      chosen.forEach((state, k) => {
        if (k && state.t - chosen[k - 1].t > 1) { line(c, piece, style); piece = []; }
        piece.push(place(state.t, state[key]));
      });
      line(c, piece, style);
    }
    line(c, [[left, top], [left, bottom], [right, bottom]], "static");
  }

  function drawHeadings() {
    for (const {name} of newest.vehicles) {
      if (!samples[name]?.length) continue;
      let canvas = get(`heading ${name}`);
      if (!canvas) {
        canvas = document.createElement("canvas");
        canvas.id = `heading ${name}`; canvas.className = "heading";
        const title = document.createElement("p");
        title.textContent = name;
        get("headings").insertBefore(title, get("heading_legend"));
        get("headings").insertBefore(canvas, get("heading_legend"));
      }
      drawHeading(canvas, samples[name]);
    }
  }

  function draw() {
    waiting = false;
    if (!newest) return;
    showStrips(); drawTable(); drawHeadings(); report();
    document.dispatchEvent(new CustomEvent("drawn", {detail: newest}));
  }
  function request() {
    if (!waiting) requestAnimationFrame(draw);
    waiting = true;
  }

  const source = new EventSource("events");
  source.onopen = () => { connected = true; };
  source.onerror = () => { connected = false; report(); };
  source.onmessage = ({data}) => {
    newest = JSON.parse(data);
    arrived = performance.now();
    delays.push(Date.now() / 1000 - newest.sent);
    if (delays.length > 10 * DURATION) delays.shift();
    newest.vehicles.forEach(keep);
    request();
  };
  addEventListener("resize", request);
  setInterval(report, 500);
  legend(get("legend"), TABLE_LEGEND);
})();
