"""A page as headless Chromium shows it."""

import base64
import json
import shutil
import subprocess
import time
import urllib.request
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib.image
import numpy as np
from websockets.sync.client import connect

CHROMIUM = shutil.which("chromium")
FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--remote-debugging-port=0",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--no-pings",
    "--disable-features=OptimizationHints,AutofillServerCommunication",
)


class Page:
    """A page that is open; `picture()` is what it shows now, as PNG."""

    def __init__(self, url: str, folder: Path, size: tuple[int, int] = (1440, 900)) -> None:
        assert CHROMIUM
        window = f"--window-size={size[0]},{size[1]}"
        self.process = subprocess.Popen(
            [CHROMIUM, *FLAGS, window, f"--user-data-dir={folder}", url],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        self.told = folder / "DevToolsActivePort"
        self.sized: Any = None

    def resize(self, width: int, height: int) -> None:
        """Give the page a size that its window cannot have: one narrower than 500 pixels."""
        self.sized = connect(self.debugger(), max_size=None)  # the size lasts as long as this
        given = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        method = "Emulation.setDeviceMetricsOverride"
        self.sized.send(json.dumps({"id": 1, "method": method, "params": given}))

    def debugger(self) -> str:
        """Return the address of the page for the DevTools protocol."""
        port = self.told.read_text().split()[0]
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
            pages = [p for p in json.load(answer) if p["type"] == "page"]
        return str(pages[0]["webSocketDebuggerUrl"])

    def picture(self) -> bytes:
        """What it shows now, as PNG."""
        return base64.b64decode(self.ask("Page.captureScreenshot")["data"])

    def text(self, element: str) -> str:
        """What an element says."""
        asked = f"document.getElementById({element!r})?.textContent ?? ''"
        return str(self.ask("Runtime.evaluate", expression=asked)["result"]["value"])

    def ask(self, method: str, timeout: float = 60.0, **given: Any) -> Any:
        """Ask over the DevTools protocol, as soon as the browser answers."""
        deadline = time.monotonic() + timeout
        while time.monotonic() < deadline:
            try:
                with connect(self.debugger(), max_size=None) as browser:
                    browser.send(json.dumps({"id": 1, "method": method, "params": given}))
                    while (reply := json.loads(browser.recv(timeout))).get("id") != 1:
                        pass
                return reply["result"]
            except (OSError, IndexError):
                time.sleep(0.2)  # it is still starting
        raise TimeoutError("the browser does not answer")

    def close(self) -> None:
        """End the browser."""
        if self.sized:
            self.sized.close()
        self.process.terminate()
        self.process.wait(20.0)


class Picture:
    """The colours of a PNG."""

    def __init__(self, png: bytes) -> None:
        self.pixels = matplotlib.image.imread(BytesIO(png), format="png")[..., :3]

    def count(self, colour: tuple[int, int, int]) -> int:
        """How many pixels have a colour, or nearly."""
        return int((np.abs(self.pixels - np.array(colour) / 255.0) < 0.06).all(-1).sum())
