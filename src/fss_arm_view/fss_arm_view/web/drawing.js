// Drawing of the table from above on a canvas: for the live page, and for the report of a mission.
// Lengths are in meters, angles in radians; colors are the CSS variables of palette.py.
const tableDrawing = (() => {
  const HALF_TABLE = 2, EDGE = 2.05, HALF_BASE = 0.135;  // [m]
  const CORNERS = [[1, 1], [-1, 1], [-1, -1], [1, -1]];  // of the base, in the thrusters' order
  const MAX_PIXELS = 1600;  // along an edge of the canvas
  const MARGIN = {left: 46, right: 8, top: 8, bottom: 40};  // around the table [px]
  const DASH = [6, 4], DOT = [2, 4];  // [px]
  const STYLES = {  // of lines: color, width [px], dashes, and the line's name in the legend
    base: ["measured", 2.5, [], "base and arm, measured"],
    predicted: ["predicted", 2.5, DASH, "base, predicted"],
    target: ["target", 2.5, [], "target"],
    zone: ["target", 1.5, DOT, "keep-out circle"],
    jet: ["thrust", 1, [], "thruster firing"],
    route: ["predicted", 1.5, DOT, "path planned"],
    base_path: ["measured", 1, [], "path of the base"],
    tip_path: ["tip", 1.5, [], "path of the end effector"],
    target_path: ["target", 1, [], "path of the target"],
  };
  const colors = {};
  const color = name => colors[name] ||=
    getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

  // Return the context of a canvas, cleared, with CSS pixels as its unit, and its size.
  function clear(canvas) {
    const width = canvas.clientWidth, height = canvas.clientHeight;
    const ratio = Math.min(devicePixelRatio, MAX_PIXELS / Math.max(width, height, 1));
    const size = [Math.round(width * ratio), Math.round(height * ratio)];
    if (canvas.width !== size[0]) canvas.width = size[0];
    if (canvas.height !== size[1]) canvas.height = size[1];
    const c = canvas.getContext("2d", {willReadFrequently: true});  // drawn without graphics card
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, width, height);
    c.lineJoin = c.lineCap = "round";
    c.fillStyle = color("text");
    c.font = `${getComputedStyle(canvas).fontSize} system-ui, sans-serif`;
    return [c, width, height];
  }

  function line(c, points, style, close = false) {  // points in pixels
    const [name, width, dashes] = STYLES[style] || [style, 1, []];
    c.beginPath();
    for (const [x, y] of points) c.lineTo(x, y);
    if (close) c.closePath();
    c.strokeStyle = color(name); c.lineWidth = width; c.setLineDash(dashes);
    c.stroke();
    c.setLineDash([]);
  }

  // Draw a scene; every part may be missing, and poses are [x, y, heading]:
  //   paths: {style: [points, ...]}
  //   targets: [{pose, fixture: point in its frame, radius: of the keep-out circle}]
  //   vehicles: [{name, pose, joints: points, predicted: pose, fired: numbers of the valves}]
  function table(canvas, scene) {
    const [c, width, height] = clear(canvas);
    const inside = Math.min(width - MARGIN.left - MARGIN.right, height - MARGIN.top - MARGIN.bottom);
    const scale = inside / (2 * EDGE);
    const pixel = ([x, y]) => [MARGIN.left + scale * (x + EDGE), MARGIN.top + scale * (EDGE - y)];
    const placed = ([x, y, angle], points) => points.map(([u, v]) => pixel([
      x + u * Math.cos(angle) - v * Math.sin(angle), y + u * Math.sin(angle) + v * Math.cos(angle),
    ]));
    const square = CORNERS.map(([x, y]) => [HALF_BASE * x, HALF_BASE * y]);
    const body = (pose, style) => {
      line(c, placed(pose, square), style, true);
      line(c, placed(pose, [[0, 0], [HALF_BASE, 0]]), style);
    };
    axes(c, pixel, inside, scale);
    c.save();
    c.beginPath(); c.rect(MARGIN.left, MARGIN.top, inside, inside); c.clip();
    for (const [style, lines] of Object.entries(scene.paths || {}))
      for (const points of lines) line(c, points.map(pixel), style);
    for (const {pose, fixture, radius} of scene.targets || []) {
      line(c, placed(pose, square), "target", true);
      c.globalAlpha = 0.3; c.fillStyle = color("target"); c.fill(); c.globalAlpha = 1;
      line(c, placed(pose, [[0, 0], fixture || [HALF_BASE, 0]]), "target");
      if (radius) {
        const steps = [...Array(65).keys()].map(k => 2 * Math.PI * k / 64);
        const around = steps.map(a => [radius * Math.cos(a), radius * Math.sin(a)]);
        line(c, placed(pose, around), "zone");
      }
    }
    for (const {name, pose, joints, predicted, fired} of scene.vehicles || []) {
      for (const jet of fired || []) {
        const [i, j] = CORNERS[jet >> 1], x = HALF_BASE * i, y = HALF_BASE * j;
        const far = 0.2, wide = 0.045;
        const ends = jet % 2 ? [[x - wide, y + far * j], [x + wide, y + far * j]]
          : [[x + far * i, y - wide], [x + far * i, y + wide]];
        line(c, placed(pose, [[x, y], ...ends]), "jet", true);
        c.fillStyle = color("thrust"); c.fill();
      }
      body(pose, "base");
      if (predicted) body(predicted, "predicted");
      if (joints) {
        const points = joints.map(pixel);
        line(c, [pixel(pose), ...points], "base");
        c.fillStyle = color("measured");
        for (const [x, y] of points) { c.beginPath(); c.arc(x, y, 3.5, 0, 7); c.fill(); }
      }
      if (name) label(c, name, pixel([pose[0] - HALF_BASE, pose[1] - 1.7 * HALF_BASE]));
    }
    c.restore();
  }

  function label(c, text, [x, y], align = "left", baseline = "top") {
    c.textAlign = align; c.textBaseline = baseline;
    c.fillStyle = color("text");
    c.fillText(text, x, y);
  }

  function axes(c, pixel, inside, scale) {
    const a = HALF_TABLE;
    for (let v = -a; v <= a; v += 0.5) {
      const name = Math.abs(v) === a ? "static" : "grid";
      line(c, [pixel([v, -a]), pixel([v, a])], name); line(c, [pixel([-a, v]), pixel([a, v])], name);
    }
    const [left, bottom] = pixel([-EDGE, -EDGE]);
    for (let v = -a; v <= a; v += 1) {
      label(c, `${v}`.replace("-", "\u2212"), [pixel([v, 0])[0], bottom + 3], "center");
      label(c, `${v}`.replace("-", "\u2212"), [left - 3, pixel([0, v])[1]], "right", "middle");
    }
    const below = bottom + MARGIN.bottom - 3;
    label(c, "x [m]", [left + inside / 2, below], "center", "bottom");
    c.save(); c.translate(2, pixel([0, 0])[1]); c.rotate(-Math.PI / 2);
    label(c, "y [m]", [0, 0], "center"); c.restore();
    const end = pixel([a, 0])[0], start = end - 0.5 * scale;  // scale bar
    line(c, [[start, below - 5], [start, below - 1], [end, below - 1], [end, below - 5]], "text");
    label(c, "0.5 m", [start - 5, below + 1], "right", "bottom");
  }

  // Fill a list with the names of styles, each beside a sample of it.
  function legend(list, styles) {
    list.replaceChildren(...styles.map(style => {
      const item = document.createElement("li"), sample = document.createElement("canvas");
      sample.width = 26; sample.height = 12;
      const c = sample.getContext("2d"), [name, , , text] = STYLES[style];
      const mark = style === "jet" ? [[2, 6], [24, 1], [24, 11]] : [[2, 6], [24, 6]];
      line(c, mark, style, style === "jet");
      c.fillStyle = color(name);
      if (style === "jet") c.fill();
      if (style === "base") { c.beginPath(); c.arc(13, 6, 3.5, 0, 7); c.fill(); }
      if (style === "target") { c.globalAlpha = 0.5; c.fillRect(7, 1, 12, 10); }
      item.append(sample, text);
      return item;
    }));
  }

  return {clear, color, label, legend, line, table};
})();
