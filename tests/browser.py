"""A headless Chromium for tests, driven over the pipe of its DevTools protocol: no driver, no port, no package.

https://chromedevtools.github.io/devtools-protocol: messages are JSON, each ended by a zero byte.
"""

from __future__ import annotations

import json
import os
import subprocess
import time
from base64 import b64decode
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from select import select
from shutil import which
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

import numpy as np
from PIL import Image

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
SECONDS = 60.0
"""Time for one answer; a busy machine draws without a GPU."""

_HARMLESS = ("file:", "data:", "blob:", "about:")
_KEYS = {"Tab": 9, "Enter": 13, " ": 32, "End": 35, "Home": 36, "ArrowLeft": 37, "ArrowRight": 39, "+": 187, "p": 80}


def find_chromium() -> str | None:
    """Return the path of a Chromium, or None where none is installed."""
    return next((path for path in map(which, NAMES) if path), None)


@contextmanager
def chromium() -> Iterator[Browser]:
    """Start a browser without a window, that draws in software; ended on leaving."""
    path = find_chromium()
    if path is None:
        raise FileNotFoundError("no Chromium is installed")
    flags = [
        *("--headless=new", "--no-sandbox", "--remote-debugging-pipe", "--use-angle=swiftshader"),
        *("--enable-unsafe-swiftshader", "--disable-dev-shm-usage", "--no-first-run", "--disable-gpu-watchdog"),
        *("--disable-background-networking", "--disable-component-update", "--hide-scrollbars"),
    ]
    to_child, from_us = os.pipe()
    to_us, from_child = os.pipe()
    with TemporaryDirectory(prefix="chromium-", ignore_cleanup_errors=True) as profile:
        start = f'exec "$@" 3<&{to_child} 4>&{from_child}'  # it reads from descriptor 3 and writes to 4
        child = subprocess.Popen(
            ["/bin/bash", "-c", start, "-", path, *flags, f"--user-data-dir={profile}", "about:blank"],
            pass_fds=(to_child, from_child),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(to_child)
        os.close(from_child)
        with os.fdopen(from_us, "wb", buffering=0) as writer, os.fdopen(to_us, "rb", buffering=0) as reader:
            try:
                yield Browser(writer, reader)
            finally:
                child.kill()
                child.wait()


@dataclass
class Browser:
    """The two ends of a browser's pipe, and all that it told of its own accord."""

    writer: BinaryIO
    reader: BinaryIO
    number: int = 0
    buffer: bytes = b""
    events: list[dict[str, Any]] = field(default_factory=list)

    def call(self, method: str, session: str | None = None, **parameters: object) -> dict[str, Any]:
        """Call a method of the protocol and return its result."""
        self.number += 1
        message = {"id": self.number, "method": method, "params": parameters}
        self.writer.write(json.dumps(message | ({"sessionId": session} if session else {})).encode() + b"\0")
        deadline = time.monotonic() + SECONDS
        while time.monotonic() < deadline:
            told = self._receive(deadline - time.monotonic())
            if told and told.get("id") == self.number:
                if "error" in told:
                    raise RuntimeError(f"{method}: {told['error']}")
                return told["result"]
        raise TimeoutError(f"{method} gave no answer within {SECONDS:.0f} s")

    def _receive(self, seconds: float) -> dict[str, Any] | None:
        """Return the next message, which is kept where it is no answer; None where none came in time."""
        while b"\0" not in self.buffer:
            if not select([self.reader], [], [], max(0.0, seconds))[0]:
                return None
            more = self.reader.read(1 << 20)
            if not more:
                raise EOFError("the browser has ended")
            self.buffer += more
        message, _, self.buffer = self.buffer.partition(b"\0")
        told = json.loads(message)
        if "method" in told:
            self.events.append(told)
        return told

    def open(
        self, path: Path, *, dark: bool = False, calm: bool = True, script: str = "", is_scripted: bool = True
    ) -> Tab:
        """Open a page from disk in a new tab and wait until it is loaded; `script` runs before its own, if any do.

        The reader prefers `dark` or light colours, and that nothing moves by itself, `calm`.
        """
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        tab = Tab(self, session, target)
        for domain in ("Page", "Runtime", "Log", "Network"):
            tab.call(f"{domain}.enable")
        theme = {"name": "prefers-color-scheme", "value": "dark" if dark else "light"}
        motion = {"name": "prefers-reduced-motion", "value": "reduce" if calm else "no-preference"}
        tab.call("Emulation.setEmulatedMedia", features=[theme, motion])
        tab.call("Emulation.setDeviceMetricsOverride", width=640, height=480, deviceScaleFactor=1, mobile=False)
        tab.call("Emulation.setScriptExecutionDisabled", value=not is_scripted)
        tab.call("Page.addScriptToEvaluateOnNewDocument", source=script)
        tab.call("Page.navigate", url=path.resolve().as_uri())
        tab.wait_until("document.readyState === 'complete'")
        return tab


@dataclass(frozen=True)
class Tab:
    """A page that is open in a browser."""

    browser: Browser
    session: str
    target: str

    def call(self, method: str, **parameters: object) -> dict[str, Any]:
        return self.browser.call(method, self.session, **parameters)

    def close(self) -> None:
        self.browser.call("Target.closeTarget", targetId=self.target)

    def run(self, expression: str) -> Any:  # noqa: ANN401 - what JSON holds
        """Return the value of a JavaScript expression; a promise is waited for."""
        told = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in told:
            raise RuntimeError(told["exceptionDetails"]["exception"].get("description", "an exception"))
        return told["result"].get("value")

    def wait_until(self, expression: str) -> None:
        deadline = time.monotonic() + SECONDS
        while not self.run(expression):
            if time.monotonic() > deadline:
                raise TimeoutError(f"never came true: {expression}")
            time.sleep(0.02)

    def press(self, key: str, *, shift: bool = False) -> None:
        """Press a key as a keyboard would, on whatever has the focus."""
        facts = {"key": key, "code": key, "windowsVirtualKeyCode": _KEYS[key], "modifiers": 8 if shift else 0}
        text = {" ": " ", "Enter": "\r"}.get(key)
        self.call("Input.dispatchKeyEvent", type="keyDown", **facts, **({"text": text} if text else {}))
        self.call("Input.dispatchKeyEvent", type="keyUp", **facts)

    def screenshot(self, selector: str | None = None, *, whole: bool = False) -> np.ndarray:
        """Return the picture of an element, of the whole page or of what is seen of it, (height, width, 3)."""
        self.run("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")
        clip: dict[str, Any] = {}
        if selector:
            box = self.run(
                f"(() => {{ const box = document.querySelector({json.dumps(selector)}).getBoundingClientRect();"
                " return [box.left + scrollX, box.top + scrollY, box.width, box.height]; })()"
            )
            clip = {"clip": dict(zip(("x", "y", "width", "height"), box, strict=True)) | {"scale": 1}}
        told = self.call("Page.captureScreenshot", captureBeyondViewport=whole or bool(selector), **clip)
        return np.asarray(Image.open(BytesIO(b64decode(told["data"]))).convert("RGB")).astype(int)

    def complaints(self) -> list[str]:
        """Return every error and warning that the console was told, and every exception."""
        return [text for event in self._events() if (text := _complaint(event["method"], event["params"]))]

    def requests(self) -> list[str]:
        """Return every address outside this machine and the page that was asked for, allowed or not."""
        sent = [event["params"] for event in self._events() if event["method"] == "Network.requestWillBeSent"]
        return [told["request"]["url"] for told in sent if not told["request"]["url"].startswith(_HARMLESS)]

    def _events(self) -> list[dict[str, Any]]:
        time.sleep(0.05)
        self.run("1")  # what is on its way arrives before the answer
        return [event for event in self.browser.events if event.get("sessionId") == self.session]


def _complaint(method: str, told: dict[str, Any]) -> str:
    if method == "Runtime.exceptionThrown":
        details = told["exceptionDetails"]
        return str(details.get("exception", {}).get("description") or details["text"])
    if method == "Runtime.consoleAPICalled" and told["type"] in {"error", "warning", "assert"}:
        return " ".join(str(entry.get("value", entry.get("description"))) for entry in told["args"])
    if method == "Log.entryAdded" and told["entry"]["level"] in {"error", "warning"}:
        return f"{told['entry']['source']}: {told['entry']['text']}"
    return ""
