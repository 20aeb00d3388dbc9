"""The page is opened where every packet that would leave is counted: there are none."""

import os
import shutil
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
from browser import CHROMIUM
from running import run_command

#: In a network of its own, whose only way out is a cable that leads nowhere: what arrives at its
#: end is counted, by where it was to go. Then the page is opened: the live one, that of rerun by
#: the gate, or by rerun's server itself.
INSIDE = """
import collections, re, socket, struct, subprocess, sys, threading, time
from pathlib import Path
sys.path.append(sys.argv[1])
from browser import Page, Picture
from fss_arm_view import sink

sent = collections.Counter()
wire = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(3))
wire.bind(("nowhere", 0))

def count():
    while True:
        packet = wire.recv(2048)
        kind = struct.unpack("!H", packet[12:14])[0]
        if kind == 0x0800:  # IPv4; what DNS is asked stands after 14 + 20 + 8 + 12 bytes
            asked = packet[23] == 17 and packet[36:38] == b"\\0\\x35"
            words = re.findall(rb"[ -~]+", packet[54:]) if asked else []
            name = b".".join(words).decode().removesuffix(".A")
            if not name.endswith((".google.com", "autofill.googleapis.com", "gvt1.com",
                                  "update.googleapis.com", "pa.googleapis.com")):  # Chromium's own
                sent[socket.inet_ntoa(packet[30:34]), name] += 1

threading.Thread(target=count, daemon=True).start()
quiet = sink.disable_analytics()
data, page = sink.free_port(), sink.free_port()
ports = sink.listen(sink.WEB, "127.0.0.1", data, page)
viewer = sink.Viewer(sink.WEB, "127.0.0.1", ports, "200MB")
if sys.argv[3] == "bare":
    words = Path(f"/proc/{viewer.processes[0].pid}/cmdline").read_text().split("\\0")
    data, page = (int(words[words.index(o) + 1]) for o in ("--port", "--web-viewer-port"))
for port in (data, page):
    while True:
        try:
            socket.create_connection(("127.0.0.1", port), 1.0).close()
            break
        except OSError:
            time.sleep(0.1)
stream = sink.open_stream(sink.WEB, viewer.url, None)
sink.rr.log("x", sink.rr.Points2D([[0.0, 0.0], [1.0, 1.0]], colors=[[255, 0, 0]], radii=0.1),
            recording=stream)
pages = {
    "live": f"http://127.0.0.1:{page}/",
    "gate": f"http://127.0.0.1:{page}/rerun",
    "bare": f"http://127.0.0.1:{page}/?url=rerun%2Bhttp://127.0.0.1:{data}/proxy",
}
browser = Page(pages[sys.argv[3]], Path(sys.argv[2]))
deadline, drawn = time.monotonic() + 120.0, False
state = '{"sent":0,"stamp":0,"silent":0,"vehicles":[{"name":"","items":[["x","y",""]]}]}'
while not drawn and time.monotonic() < deadline:
    viewer.send(state)
    png = browser.picture()
    if sys.argv[3] == "live":
        drawn = "y" in browser.text("strips")
        continue
    drawn = Picture(png).count((255, 0, 0)) > 100
    if sys.argv[3] == "bare" and sent:
        break
    time.sleep(1.0)
Path(sys.argv[2], "page.png").write_bytes(png)
time.sleep(5.0)  # for what is asked for late; nothing can tell when there is no more
print("drawn", drawn, "sent", dict(sent), flush=True)
browser.close()
viewer.close()
"""


def may_make_networks():
    return os.geteuid() == 0 and shutil.which("ip") is not None


@contextmanager
def network():
    name = f"fss_view_{os.getpid()}"

    def run(*words):
        subprocess.run(words, check=True)

    run("ip", "netns", "add", name)
    inside = "ip", "netns", "exec", name
    try:
        run(*inside, "ip", "link", "set", "lo", "up")
        run(*inside, "ip", "link", "add", "away", "type", "veth", "peer", "nowhere")
        run(*inside, "ip", "addr", "add", "10.99.0.2/24", "dev", "away")
        for end in ("away", "nowhere"):
            run(*inside, "ip", "link", "set", end, "up")
        run(*inside, "ip", "route", "add", "default", "via", "10.99.0.1")
        router = "10.99.0.1", "lladdr", "02:00:00:00:00:01"
        run(*inside, "ip", "neigh", "add", *router, "dev", "away")
        yield inside
    finally:
        run("ip", "netns", "delete", name)


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="needs chromium, Debian's package of that name")
@pytest.mark.skipif(not may_make_networks(), reason="needs root and iproute2, for a network")
@pytest.mark.parametrize(("way", "leaves"), [("live", False), ("gate", False), ("bare", True)])
def test_the_page_asks_nobody_else(tmp_path, way, leaves):
    support = str(Path(__file__).parents[2] / "support")
    folder = tmp_path / "browser"
    folder.mkdir()
    with network() as inside:
        command = *inside, sys.executable, "-c", INSIDE, support, folder, way
        done = run_command(*command, timeout=240.0)
    print(done.stdout, done.stderr)
    assert ("sent {}" not in done.stdout) == leaves
    if way != "bare":
        assert "drawn True" in done.stdout
