"""Additions of the gate to rerun's page: the strip above it, and the age of the drawings.

The page requests STATUS_PATH from the gate; the node keeps the answer in a file. It asks rerun for
the time at which it draws; the difference is the age of the drawings. A page that lags far behind,
as on a busy computer, is reloaded, and receives the newest drawings first.
"""

STATUS_PATH = "/fss/now"

SCRIPT = """
<style>
  canvas { top: 46px !important; height: calc(100% - 46px) !important; }
  #fss { position: fixed; top: 0; left: 0; right: 0; height: 46px; z-index: 9; display: flex;
    overflow: hidden; background: #fff; color: #222; font: 13px sans-serif; gap: 18px;
    padding: 0 12px; align-items: center; border-bottom: 1px solid #bbb; white-space: nowrap; }
  #fss div { line-height: 1.1; } #fss b { font-size: 19px; } #fss small { color: #777; }
  #fss .good b { color: #17803d; } #fss .warn b { color: #b35900; }
  #fss .alarm { background: #c81e1e; padding: 4px 8px; } #fss .alarm * { color: #fff; }
  #fss .last { margin-left: auto; text-align: right; }
  #fss_age { position: fixed; top: 46px; left: 0; right: 0; z-index: 10; display: none;
    cursor: pointer; padding: 10px; background: #c81e1e; color: #fff; text-align: center;
    font: bold 34px sans-serif; }
  #fss_wait { position: fixed; top: 46px; left: 0; right: 0; bottom: 0; z-index: 8; color: #777;
    background: #fff; font: 19px sans-serif; display: grid; place-items: center; }
</style>
<div id="fss"></div><div id="fss_wait">loading the drawings</div>
<div id="fss_age" title="reload the page, newest data first"></div>
<script>
(() => {
  // [s] age that is reported; lag at which the page is reloaded; first time between reloads
  const MAX_AGE = 3, MAX_LAG = 20, RELOAD_PERIOD = 90;
  const age = document.getElementById("fss_age"), strip = document.getElementById("fss");
  const started = Date.now(), wait = document.getElementById("fss_wait");
  let lagging = 0, first = 0;  // successive checks that found a large lag; first drawing at
  const reloads = Number(sessionStorage.fss_reloads || 0);  // without success: a slow computer
  age.onclick = () => location.reload();

  function fields(bytes) {  // of a protocol buffer, by number: integers and byte arrays
    const found = {};
    let at = 0;
    const integer = () => {
      let value = 0n, shift = 0n, byte;
      do { byte = bytes[at++]; value |= BigInt(byte & 127) << shift; shift += 7n; }
      while (byte & 128);
      return value;
    };
    while (at < bytes.length) {
      const key = Number(integer()), number = key >> 3;
      if ((key & 7) !== 0 && (key & 7) !== 2) break;
      let value = integer();
      if ((key & 7) === 2) value = bytes.subarray(at, at += Number(value));
      (found[number] ||= []).push(value);
    }
    return found;
  }

  function times() {  // time that rerun displays, and time of its newest data [ns]
    const state = fields(window._handle.viewer_state()), text = new TextDecoder();
    const active = text.decode(state[2][0]);
    for (const recording of state[3].map(fields)) {
      if (text.decode(recording[1][0]) !== active || !recording[3]) continue;
      const name = of => text.decode(fields(of)[1][0]);
      const current = fields(recording[3][0]), timeline = name(current[1][0]);
      for (const one of recording[2].map(fields))
        if (name(one[1][0]) === timeline && one[3])
          return [fields(current[3][0])[1][0], fields(one[3][0])[2][0]];
    }
  }

  function show(items, name) {
    const group = name ? [["vehicle", name, ""]] : [];
    for (const [what, value, style] of [...group, ...items]) {
      const item = document.createElement("div");
      item.className = style;
      const label = document.createElement("small"), text = document.createElement("b");
      label.textContent = what; text.textContent = value;
      item.append(label, document.createElement("br"), text);
      strip.append(item);
    }
  }

  async function update() {
    let warning = "", shown;
    try { shown = times(); } catch { /* rerun has drawn nothing yet, or is of another version */ }
    first ||= shown ? Date.now() : 0;
    if (first || Date.now() - started > 6e4) wait.style.display = "none";
    try {
      const answer = await fetch("STATUS_PATH", {cache: "no-store"});
      const {age: since, status: now} = await answer.json();
      const newest = BigInt(now.newest), silent = now.silent + since;
      strip.replaceChildren();
      for (const vehicle of now.vehicles) show(vehicle.items, vehicle.name);
      show([["time here", new Date().toLocaleTimeString("en-GB"), "last"]]);
      if (newest && silent > MAX_AGE) warning = `NO DATA FOR ${Math.round(silent)} s`;
      else if (newest && shown) {
        const old = Number(newest - shown[0]) / 1e9, lag = Number(newest - shown[1]) / 1e9;
        if (old > MAX_AGE) warning = `DATA ${Math.round(old)} s OLD`;
        lagging = lag > MAX_LAG ? lagging + 1 : 0;
        if (lag < MAX_AGE) sessionStorage.fss_reloads = 0;
        if (lagging > 5 && Date.now() - first > 1e3 * RELOAD_PERIOD * 2 ** reloads) {
          sessionStorage.fss_reloads = reloads + 1;
          location.reload();
        }
      } else if (newest && Date.now() - started > 1e4) warning = "NOTHING IS SHOWN YET";
    } catch { warning = "THE VIEW DOES NOT ANSWER"; }
    age.textContent = warning;
    age.style.display = warning ? "block" : "none";
    setTimeout(update, 500);
  }
  update();
})();
</script>
""".replace("STATUS_PATH", STATUS_PATH)


def with_strip(page: bytes) -> bytes:
    """Return the page with the strip inserted before the end of its body."""
    body, end, rest = page.rpartition(b"</body>")
    return body + SCRIPT.encode() + end + rest if end else page
