"""A headless Chromium driven over its DevTools protocol, through a pipe: no server, no library."""

import base64
import contextlib
import json
import shutil
import subprocess
import time
from pathlib import Path

import pytest

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)
needs_chromium = pytest.mark.skipif(
    CHROMIUM is None, reason="needs Chromium or Chrome on the PATH to open pages"
)
AXE = Path(__file__).parents[2] / "node_modules" / "axe-core" / "axe.min.js"
needs_axe = pytest.mark.skipif(
    not AXE.is_file(), reason="needs axe-core in node_modules to check pages for accessibility"
)
FLAGS = ("--headless=new", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--mute-audio")
# Chromium reads commands from descriptor 3 and answers on 4.
SHELL = 'exec "$0" "$@" 3<&0 4>&1 </dev/null >/dev/null'


class NavigatedError(Exception):
    """The page changed while Chromium was working on a command."""

    MESSAGE = "Inspected target navigated or closed"


class Tab:
    """One page; `complaints` collects what its console, its scripts and its policy complain of."""

    def __init__(self, process):
        self.process, self.buffer, self.count, self.session = process, b"", 0, None
        self.complaints, self.requests = [], []
        target = self.ask("Target.createTarget", url="about:blank")["targetId"]
        attached = self.ask("Target.attachToTarget", targetId=target, flatten=True)
        self.session = attached["sessionId"]
        for domain in ("Runtime", "Log", "Page", "Network"):
            self.ask(f"{domain}.enable")

    def ask(self, method, **params):
        """The answer to one command."""
        self.count += 1
        message = {"id": self.count, "method": method, "params": params}
        if self.session:
            message["sessionId"] = self.session
        self.process.stdin.write(json.dumps(message).encode() + b"\0")
        self.process.stdin.flush()
        while (answer := self._receive()).get("id") != self.count:
            self._note(answer)
        if answer.get("error", {}).get("message") == NavigatedError.MESSAGE:
            raise NavigatedError(method)
        assert "error" not in answer, answer["error"]
        return answer["result"]

    def open(self, path, width=1300, height=900):
        """Loads a file."""
        self.ask(
            "Emulation.setDeviceMetricsOverride",
            width=width,
            height=height,
            deviceScaleFactor=1,
            mobile=False,
        )
        self.go(path.absolute().as_uri())

    def go(self, url):
        """Loads an address."""
        self.ask("Page.navigate", url=url)
        self.wait_for(f"document.readyState === 'complete' && location.href === {url!r}")

    def run(self, script):
        """The value of a JavaScript expression."""
        found = self.ask("Runtime.evaluate", expression=script, returnByValue=True)
        assert "exceptionDetails" not in found, found["exceptionDetails"]
        return found["result"].get("value")

    def wait_for(self, script, seconds=300.0):
        """Returns as soon as a JavaScript expression is true."""
        end = time.monotonic() + seconds
        while not self._holds(script):
            assert time.monotonic() < end, f"still not true: {script}"
            time.sleep(0.05)

    def prefer(self, scheme):
        """Opens pages from now on in a `light` or `dark` scheme of colours."""
        features = [{"name": "prefers-color-scheme", "value": scheme}]
        self.ask("Emulation.setEmulatedMedia", features=features)

    def violations(self):
        """What axe-core finds wrong with the page: rule, and the first element that breaks it."""
        self.run(AXE.read_text(encoding="utf-8") + ";0")
        self.run("delete window.found, axe.run().then((all) => window.found = all.violations), 0")
        self.wait_for("window.found !== undefined")
        return self.run(
            "window.found.map((v) => [v.id, v.nodes[0].html, v.nodes[0].failureSummary])"
        )

    def press(self, key, code):
        """Presses a key, as a person at the keyboard would."""
        for kind in ("keyDown", "keyUp"):
            text = {"text": "\r"} if key == "Enter" and kind == "keyDown" else {}
            self.ask(
                "Input.dispatchKeyEvent",
                type=kind,
                key=key,
                code=key,
                windowsVirtualKeyCode=code,
                **text,
            )

    def screenshot(self, path):
        """Writes what the window shows as a PNG."""
        path.write_bytes(base64.b64decode(self.ask("Page.captureScreenshot")["data"]))

    def _holds(self, script):
        try:
            return self.run(script)
        except NavigatedError:  # the page has changed under the question
            return False

    def _receive(self):
        while b"\0" not in self.buffer:
            piece = self.process.stdout.read1(1 << 20)
            assert piece, "Chromium has ended"
            self.buffer += piece
        message, self.buffer = self.buffer.split(b"\0", 1)
        return json.loads(message)

    def _note(self, event):
        params = event.get("params", {})
        match event.get("method"):
            case "Runtime.exceptionThrown":
                self.complaints.append(params["exceptionDetails"])
            case "Runtime.consoleAPICalled" if params["type"] in ("error", "warning", "assert"):
                self.complaints.append(params["args"])
            case "Log.entryAdded":
                self.complaints.append(params["entry"])
            case "Page.javascriptDialogOpening":
                self.complaints.append(params)
            case "Network.requestWillBeSent":
                self.requests.append(params["request"]["url"][:200])


@contextlib.contextmanager
def tab(profile):
    """A tab of a fresh Chromium whose profile is the folder `profile`."""
    command = [CHROMIUM, *FLAGS, "--remote-debugging-pipe", f"--user-data-dir={profile}"]
    process = subprocess.Popen(
        ["sh", "-c", SHELL, *command],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield Tab(process)
    finally:
        process.terminate()
        process.wait(30)
        process.stdin.close()
        process.stdout.close()
