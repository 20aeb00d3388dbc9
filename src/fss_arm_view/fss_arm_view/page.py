"""Files of the live page, and the line above rerun's page."""

from pathlib import Path

from fss_arm_ros.palette import css

WEB = Path(__file__).parent / "web"
EVENTS, HISTORY = "/events", "/rerun"  # paths of the states, and of rerun's page
TYPES = {".html": "text/html; charset=utf-8", ".css": "text/css", ".js": "text/javascript"}
FILES = {"/": "page.html", **{f"/{name}": name for name in ("page.css", "page.js", "drawing.js")}}

NOTE = """
<style>
  canvas { top: 28px !important; height: calc(100% - 28px) !important; }
  #fss { position: fixed; top: 0; left: 0; right: 0; height: 28px; z-index: 9; background: #fff;
    color: #222; font: 13px/28px sans-serif; padding: 0 10px; white-space: nowrap; overflow: auto; }
</style>
<div id="fss">rerun <b>may lag by a minute</b> on a busy computer: compare its time (UTC) with the
newest data, <b id="fss_newest">unknown</b>. The <a href="/">live page</a> is current.</div>
<script>
  new EventSource("/events").onmessage = ({data}) => {
    const time = new Date(1000 * JSON.parse(data).stamp).toISOString();
    document.getElementById("fss_newest").textContent = `${time.slice(11, 19)} UTC`;
  };
</script>
"""


def page_file(path: str) -> tuple[str, bytes] | None:
    """Return type and content of a file of the live page; None: there is no such file."""
    if path not in FILES:
        return None
    file = WEB / FILES[path]
    content = file.read_text(encoding="utf-8")
    return TYPES[file.suffix], (css() + content if file.suffix == ".css" else content).encode()


def drawing_script() -> str:
    """Return the script that draws the table; it needs the CSS variables of `palette.css`."""
    return (WEB / "drawing.js").read_text(encoding="utf-8")


def with_note(page: bytes) -> bytes:
    """Return rerun's page with a line about its lag inserted before the end of its body."""
    body, end, rest = page.rpartition(b"</body>")
    return body + NOTE.encode() + end + rest if end else page
