# SPDX-License-Identifier: MIT
"""Headless Chromium through its DevTools pipe: pages, scripts in them, keys, mouse, touch and screenshots."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from queue import Empty, Queue
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
_FLAGS = (
    "--headless=new", "--remote-debugging-pipe", "--no-sandbox", "--disable-gpu-sandbox",
    "--enable-unsafe-swiftshader", "--use-angle=swiftshader", "--disable-gpu-compositing", "--no-first-run",
    "--disable-extensions", "--disable-background-networking", "--disable-component-update", "--hide-scrollbars",
    "--mute-audio",
)  # fmt: skip
_AS_THREE_AND_FOUR = """
import os, sys
for end, number in zip(map(int, sys.argv[1:3]), (3, 4)):
    os.dup2(end, number)
    os.close(end)
os.execv(sys.argv[3], sys.argv[3:])
"""
"""File descriptors of the pipe on the browser's side."""
_WAIT = 60  # s, for an answer
_CODES = {"ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, "ArrowDown": 40, "Tab": 9, "PageUp": 33, "PageDown": 34}


def require_chromium() -> str:
    """Return the browser's path; skip where there is none, fail on CI."""
    for name in NAMES:
        if found := shutil.which(name):
            return found
    if os.environ.get("CI"):
        pytest.fail("chromium is missing; .ci/run installs it")
    pytest.skip("no Chromium (Debian: apt-get install chromium)")


class Page:
    """A tab; every method waits for the browser's answer."""

    def __init__(self, browser: Browser, session: str) -> None:
        self._browser, self._session = browser, session
        self.errors: list[str] = []
        """Exceptions, console errors and log entries at level error, since the page was opened."""
        self.requests: list[str] = []
        """Addresses that the page requested."""

    def do(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Send a DevTools command."""
        return self._browser.ask(method, parameters, self._session)

    def see(self, event: dict[str, Any]) -> None:
        """Record what an event of the page reports, such as an error in its console."""
        method, data = event["method"], event.get("params", {})
        if method == "Runtime.exceptionThrown":
            details = data["exceptionDetails"]
            self.errors.append(details.get("exception", {}).get("description") or details["text"])
        elif method == "Runtime.consoleAPICalled" and data["type"] in ("error", "warning", "assert"):
            self.errors.append(str([each.get("value", each.get("description")) for each in data["args"]]))
        elif method == "Log.entryAdded" and data["entry"]["level"] == "error":
            self.errors.append(data["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            self.requests.append(data["request"]["url"])

    def js(self, expression: str) -> Any:
        """Return the value of an expression (a promise's, where it is one), as JSON carries it."""
        answer = self.do("Runtime.evaluate", expression=expression, awaitPromise=True, returnByValue=True)
        if "exceptionDetails" in answer:
            raise AssertionError(answer["exceptionDetails"].get("exception", {}).get("description", answer))
        return answer["result"].get("value")

    def settle(self) -> None:
        """Wait until two frames have been drawn."""
        self.js("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(null))))")

    def open(self, file: Path) -> None:
        """Load a file and wait until its playground has started."""
        self.do("Page.navigate", url=file.resolve().as_uri())
        self.js(
            "new Promise((done, fail) => { const begun = Date.now(); (function look() {"
            " if (window.playground?.now?.matrices) done(null);"
            " else if (Date.now() - begun > 30000) fail(new Error(document.body?.innerText ?? 'nothing'));"
            " else setTimeout(look, 20); })(); })"
        )
        self.settle()

    def window(self, width: int, height: int, *, scale: float = 1, touch: bool = False) -> None:
        """Return the size of the page [CSS pixels]."""
        self.do("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=scale, mobile=touch)
        self.do("Emulation.setTouchEmulationEnabled", enabled=touch)

    def prefer(self, **features: str) -> None:
        """Set media features, such as ``prefers_color_scheme="dark"``."""
        chosen = [{"name": name.replace("_", "-"), "value": value} for name, value in features.items()]
        self.do("Emulation.setEmulatedMedia", features=chosen)

    def press(self, key: str, times: int = 1, *, shift: bool = False) -> None:
        """Press and release a key, some times, with or without shift."""
        code = _CODES.get(key, 0)
        for _ in range(times):
            for kind in ("rawKeyDown", "keyUp"):
                self.do(
                    "Input.dispatchKeyEvent", type=kind, key=key, code=key, windowsVirtualKeyCode=code,
                    modifiers=8 if shift else 0,
                )  # fmt: skip

    def drag(self, places: Sequence[tuple[float, float]], *, touch: bool = False) -> None:
        """Press at the first place, move over the others, release."""
        for k, (x, y) in enumerate([*places, places[-1]]):
            last = k == len(places)
            if touch:
                kind = "touchStart" if k == 0 else "touchEnd" if last else "touchMove"
                self.do("Input.dispatchTouchEvent", type=kind, touchPoints=[] if last else [{"x": x, "y": y}])
            else:
                kind = "mousePressed" if k == 0 else "mouseReleased" if last else "mouseMoved"
                self.do("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", buttons=1, clickCount=1)


class Browser:
    """Process of the browser, with a thread that reads its messages."""

    def __init__(self, program: str, profile: str) -> None:
        """Start Chromium with its debugging pipes at the file numbers 3 and 4, and a thread that reads its answers."""
        (to_read, self._write), (self._read, to_write) = os.pipe(), os.pipe()
        # Use numbers that are neither 3 nor 4, so that no copy closes a pipe that is still to be copied.
        to_read, to_write = (_moved_up(end) for end in (to_read, to_write))
        self.process = subprocess.Popen(
            [sys.executable, "-c", _AS_THREE_AND_FOUR, str(to_read), str(to_write), program, *_FLAGS,
             f"--user-data-dir={profile}", "about:blank"],
            stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            pass_fds=(to_read, to_write), start_new_session=True,
        )  # fmt: skip
        os.close(to_read)
        os.close(to_write)
        self._answers: Queue[dict[str, Any]] = Queue()
        self.pages: dict[str, Page] = {}
        self._number = 0
        self._reader = threading.Thread(target=self._listen, daemon=True)
        self._reader.start()

    def _listen(self) -> None:
        """Read messages, which end with a zero byte: answers go to the queue, events to their page."""
        left = b""
        while chunk := os.read(self._read, 1 << 16):
            *messages, left = (left + chunk).split(b"\0")
            for message in map(json.loads, messages):
                if "id" in message:
                    self._answers.put(message)
                elif page := self.pages.get(message.get("sessionId", "")):
                    page.see(message)

    def ask(self, method: str, parameters: dict[str, Any], session: str | None = None) -> dict[str, Any]:
        """Send a command and return its result; fail if Chromium does not answer within _WAIT seconds."""
        self._number += 1
        message = {"id": self._number, "method": method, "params": parameters}
        if session:
            message["sessionId"] = session
        os.write(self._write, json.dumps(message).encode() + b"\0")
        while True:
            try:
                answer = self._answers.get(timeout=_WAIT)
            except Empty:
                raise AssertionError(f"Chromium does not answer {method}") from None
            if answer["id"] == self._number:
                assert "error" not in answer, (method, answer["error"])
                return dict(answer["result"])

    def page(self) -> Page:
        target = self.ask("Target.createTarget", {"url": "about:blank"})["targetId"]
        session = self.ask("Target.attachToTarget", {"targetId": target, "flatten": True})["sessionId"]
        page = self.pages[session] = Page(self, session)
        for domain in ("Page", "Runtime", "Log", "Network"):
            page.do(f"{domain}.enable")
        return page

    def close(self) -> None:
        """End the browser with its children, and the reading thread."""
        self.process.terminate()
        try:
            self.process.wait(20)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
        # A child of the browser that outlives it would keep the pipe open, and the reader waiting.
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self.process.pid, signal.SIGKILL)
        self._reader.join()
        os.close(self._read)
        os.close(self._write)


def _moved_up(end: int) -> int:
    moved = fcntl.fcntl(end, fcntl.F_DUPFD_CLOEXEC, 10)
    os.close(end)
    return moved


@contextmanager
def chromium() -> Iterator[Browser]:
    """Start a browser with a temporary profile; it ends with the test."""
    program = require_chromium()
    with tempfile.TemporaryDirectory(prefix="stiffgen-browser-", ignore_cleanup_errors=True) as profile:
        browser = Browser(program, profile)
        try:
            yield browser
        finally:
            browser.close()
