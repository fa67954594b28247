"""A headless Chromium that tests drive by its DevTools protocol (tornado's sockets)."""

import asyncio
import base64
import io
import json
import os
import shutil
import subprocess
import time
from pathlib import Path
from typing import Any

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
FLAGS = (
    *("--headless=new", "--no-sandbox", "--use-angle=swiftshader"),
    *("--enable-unsafe-swiftshader", "--disable-gpu-sandbox", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update"),
    *("--disable-dev-shm-usage", "--remote-debugging-port=0", "--mute-audio"),
)
_PATIENCE = 120.0  # with one answer, on a machine however slow [s]


def command() -> str | None:
    """Chromium's command, or None where there is none; ``CHROMIUM`` names another."""
    return os.environ.get("CHROMIUM") or next(
        filter(None, map(shutil.which, NAMES)), None
    )


class Browser:
    """A browser with one page.

    Attributes:
        requests: Addresses that the page asked for.
        complaints: What it logged as an error or a warning, and what it threw.
        downloads: Folder of the files that it saves.
    """

    def __init__(self, folder: Path):
        """Start one with its files in a folder."""
        self.requests: list[str] = []
        self.complaints: list[str] = []
        self.downloads = folder / "downloads"
        self.downloads.mkdir()
        chosen = command()
        assert chosen is not None
        self._loop = asyncio.new_event_loop()
        self._number = 0
        self._process = subprocess.Popen(
            [chosen, *FLAGS, f"--user-data-dir={folder / 'profile'}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        port = folder / "profile" / "DevToolsActivePort"
        wait_until(lambda: port.exists() and port.read_text().count("\n") == 1)
        self._loop.run_until_complete(self._connect(port.read_text().split()[0]))
        where = {"behavior": "allow", "downloadPath": str(self.downloads)}
        self.ask("Browser.setDownloadBehavior", **where)
        for domain in ("Page", "Network", "Runtime", "Log"):
            self.ask(f"{domain}.enable")

    async def _connect(self, port: str) -> None:
        from tornado.httpclient import AsyncHTTPClient
        from tornado.websocket import websocket_connect

        told = await AsyncHTTPClient().fetch(f"http://127.0.0.1:{port}/json")
        (page,) = [x for x in json.loads(told.body) if x["type"] == "page"]
        address = page["webSocketDebuggerUrl"]
        self._socket = await websocket_connect(address, max_message_size=2**28)

    def close(self) -> None:
        """End it."""
        self._socket.close()
        self._loop.run_until_complete(asyncio.sleep(0.05))
        self._process.terminate()
        self._process.wait()
        self._loop.close()

    def ask(self, method: str, **parameters: Any) -> dict[str, Any]:
        """The answer to a command of the protocol."""
        return self._loop.run_until_complete(
            asyncio.wait_for(self._answer(method, parameters), _PATIENCE)
        )

    async def _answer(self, method: str, parameters: dict[str, Any]) -> dict[str, Any]:
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        await self._socket.write_message(json.dumps(message))
        while True:
            told = json.loads(await self._socket.read_message())
            if told.get("id") == self._number:
                assert "error" not in told, told
                return told["result"]
            self._note(told.get("method"), told.get("params", {}))

    def _note(self, method: str | None, about: dict[str, Any]) -> None:
        if method == "Network.requestWillBeSent":
            self.requests.append(about["request"]["url"])
        elif method == "Runtime.exceptionThrown":
            self.complaints.append(str(about["exceptionDetails"]))
        elif method == "Runtime.consoleAPICalled":
            if about["type"] in ("error", "warning", "assert"):
                self.complaints.append(str(about["args"]))
        elif method == "Log.entryAdded":
            entry = about["entry"]
            # of the drawing on a processor, which is the machine's
            if entry["level"] in ("error", "warning") and "WebGL" not in entry["text"]:
                self.complaints.append(entry["text"])

    def open(
        self, path: Path, hash: str = "", size: tuple[int, int] = (900, 700)
    ) -> None:
        """Load a page from disk, and wait for its first picture."""
        self.visit(f"{path.resolve().as_uri()}{hash}", size)

    def visit(self, address: str, size: tuple[int, int] = (900, 700)) -> None:
        """Load a page by its address, and wait for its first picture."""
        self.requests.clear()
        self.complaints.clear()
        # a motion that plays, drawn by a processor, leaves no time for anything else
        self.run("window.rollkane?.player && (rollkane.player.playing = false, true)")
        self.resize(size)
        self.ask("Page.navigate", url="about:blank")
        self.ask("Page.navigate", url=address)
        wait_until(lambda: self.run("document.readyState === 'complete'"))
        self.settle()

    def resize(self, size: tuple[int, int]) -> None:
        """Give the window's content another size [px]."""
        width, height = size
        how = {"deviceScaleFactor": 1, "mobile": False}
        self.ask(
            "Emulation.setDeviceMetricsOverride", width=width, height=height, **how
        )
        self.settle()

    def settle(self) -> None:
        """Wait until what was asked of the page is drawn."""
        self.run(
            "new Promise((done) => requestAnimationFrame(() => "
            "requestAnimationFrame(() => done(true))))"
        )

    def run(self, code: str) -> Any:
        """Value of an expression in the page; promises are waited for."""
        how = {"returnByValue": True, "awaitPromise": True}
        told = self.ask("Runtime.evaluate", expression=code, **how)
        assert "exceptionDetails" not in told, told["exceptionDetails"]
        return told["result"].get("value")

    def click(self, name: str) -> None:
        """Press and release the mouse over an element."""
        x, y = self.run(
            f"(() => {{ const b = document.getElementById('{name}')"
            ".getBoundingClientRect();"
            "return [b.x + b.width / 2, b.y + b.height / 2]; })()"
        )
        for kind in ("mousePressed", "mouseReleased"):
            how = {"x": x, "y": y, "button": "left", "clickCount": 1}
            self.ask("Input.dispatchMouseEvent", type=kind, **how)
        self.settle()

    def press(self, key: str) -> None:
        """Press and release a key."""
        codes = {"ArrowRight": 39, "ArrowLeft": 37, " ": 32}
        how = {"key": key, "windowsVirtualKeyCode": codes[key]}
        how |= {"code": "Space" if key == " " else key}
        self.ask("Input.dispatchKeyEvent", type="keyDown", **how)
        self.ask("Input.dispatchKeyEvent", type="keyUp", **how)
        self.settle()

    def picture(self) -> Any:
        """What is seen, as an array of colours (height, width, 3), 0 to 1."""
        from matplotlib.image import imread

        told = self.ask("Page.captureScreenshot", format="png")
        return imread(io.BytesIO(base64.b64decode(told["data"])))[..., :3]

    def downloaded(self, ending: str) -> Path:
        """The file with an ending that the page saves, when it is whole."""
        found: list[Path] = []

        def there() -> bool:
            found[:] = self.downloads.glob(f"*{ending}")
            return bool(found) and found[0].stat().st_size > 0

        wait_until(there)
        return found[0]


def wait_until(true: Any) -> None:
    """Wait for something that comes at its own pace."""
    begun = time.monotonic()
    while not true():
        assert time.monotonic() - begun < _PATIENCE, "it does not come"
        time.sleep(0.02)
