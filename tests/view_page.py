#!/usr/bin/env python3
"""Opens a page of `cregopt view` in headless Chromium and operates it: `view_page.py PAGE.html [SCREENSHOT.png [WIDTHxHEIGHT]]`.

Checks that the page opens without console messages, that it plays, that its controls change time, plots and picture, and that it loads nothing. It uses the
DevTools protocol over a pipe, and needs only Chromium and Python. Exit code 77: Chromium is not installed.
"""

import base64
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time

NAMES = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome"]
PATIENCE = 60


class Browser:
    """Tab of a headless Chromium."""

    def __init__(self, program, profile):
        ours_in, theirs_out = os.pipe()
        theirs_in, ours_out = os.pipe()

        def hand_over():
            # Chromium uses the descriptors 3 and 4. The copies prevent that one overwrites the other.
            reading, writing = os.dup(theirs_in), os.dup(theirs_out)
            os.dup2(reading, 3)
            os.dup2(writing, 4)

        flags = ["--headless=new", "--no-sandbox", "--no-first-run", "--remote-debugging-pipe", "--enable-unsafe-swiftshader", "--use-angle=swiftshader",
                 "--hide-scrollbars", "--disable-extensions", "--disable-background-networking", f"--user-data-dir={profile}"]
        self.process = subprocess.Popen([program, *flags, "about:blank"], preexec_fn=hand_over, close_fds=False,
                                        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        os.close(theirs_in)
        os.close(theirs_out)
        self.reading, self.writing = os.fdopen(ours_in, "rb"), os.fdopen(ours_out, "wb")
        self.buffer, self.number, self.session = b"", 0, None
        self.messages, self.requests = [], []
        target = self.call("Target.createTarget", url="about:blank")["targetId"]
        self.session = self.call("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        for domain in ["Page", "Runtime", "Log", "Network"]:
            self.call(f"{domain}.enable")

    def message(self):
        while b"\0" not in self.buffer:
            part = os.read(self.reading.fileno(), 1 << 20)
            if not part:
                raise SystemExit("Chromium has ended")
            self.buffer += part
        text, self.buffer = self.buffer.split(b"\0", 1)
        message = json.loads(text)
        method, params = message.get("method"), message.get("params", {})
        if method == "Runtime.exceptionThrown":
            details = params["exceptionDetails"]
            self.messages.append(details.get("exception", {}).get("description") or details["text"])
        elif method == "Runtime.consoleAPICalled" and params["type"] in ("error", "warning", "assert"):
            self.messages.append(" ".join(str(a.get("value", a.get("description"))) for a in params["args"]))
        elif method == "Log.entryAdded" and params["entry"]["level"] in ("error", "warning"):
            self.messages.append(params["entry"]["text"])
        elif method == "Network.requestWillBeSent":
            self.requests.append(params["request"]["url"])
        return message

    def call(self, method, **params):
        self.number += 1
        request = {"id": self.number, "method": method, "params": params}
        if self.session:
            request["sessionId"] = self.session
        self.writing.write(json.dumps(request).encode() + b"\0")
        self.writing.flush()
        end = time.time() + PATIENCE
        while time.time() < end:
            answer = self.message()
            if answer.get("id") == self.number:
                if "error" in answer:
                    raise SystemExit(f"{method}: {answer['error']}")
                return answer["result"]
        raise SystemExit(f"{method}: no answer in {PATIENCE} s")

    def run(self, script):
        answer = self.call("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        if "exceptionDetails" in answer:
            raise SystemExit(f"{script}: {answer['exceptionDetails']}")
        return answer["result"].get("value")

    def open(self, url, width, height):
        self.call("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=False)
        self.call("Page.navigate", url=url)
        self.wait("document.readyState === 'complete'")

    def wait(self, condition):
        end = time.time() + PATIENCE
        while not self.run(f"Boolean({condition})"):
            if time.time() > end:
                raise SystemExit(f"never became true: {condition}")
            time.sleep(0.05)

    def picture(self):
        return base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])

    def close(self):
        self.session = None
        try:
            self.call("Browser.close")
        except (SystemExit, OSError):
            self.process.kill()
        self.process.wait(timeout=20)


# Waits two frames: one applies a change, the next one has drawn it.
DRAWN = "new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(true))))"
# Checksum and number of colours of the 3D view, read in the frame in which it is drawn.
SEEN = """new Promise((done) => requestAnimationFrame(() => {
  const canvas = document.querySelector('.stage canvas');
  panes[0].view.dirty = true;
  panes[0].view.render();
  const small = document.createElement('canvas');
  [small.width, small.height] = [160, 100];
  const g = small.getContext('2d');
  g.drawImage(canvas, 0, 0, 160, 100);
  const pixels = g.getImageData(0, 0, 160, 100).data;
  const colors = new Set();
  let sum = 0;
  for (let i = 0; i < pixels.length; i += 4) {
    const color = pixels[i] * 65536 + pixels[i + 1] * 256 + pixels[i + 2];
    colors.add(color);
    sum = (sum * 31 + color) % 1000000007;
  }
  done([sum, colors.size]);
}))"""


def check(condition, message):
    if not condition:
        raise SystemExit(f"failed: {message}")


def use(browser):
    """Operates the page: playback, slider, plots, views, layers, results and window width."""
    browser.wait("typeof panes !== 'undefined' && document.querySelectorAll('.pane').length === data.results.length")
    check(browser.run("document.querySelectorAll('.stage .message').length") == 0, "a 3D view in every pane")
    check(browser.run("horizon > 0 && Number(document.getElementById('time').max) === horizon"), "the slider ends with the motion")
    # Playback runs in real time, or slower if drawing is slow.
    first = browser.run("setPlaying(true), clock.time")
    browser.wait(f"clock.time > {first} + 0.2 || clock.time < {first}")
    browser.run("document.getElementById('play').click()")
    check(not browser.run("clock.playing"), "the button pauses")
    stopped = browser.run("clock.time")
    time.sleep(0.3)
    check(browser.run("clock.time") == stopped, "time does not change while paused")
    # The slider changes time, cursor, values and picture.
    scrub = "const t = document.getElementById('time'); t.value = {}; t.dispatchEvent(new Event('input')); clock.time"
    state = "[document.querySelector('.cursor').style.transform, document.querySelector('.plots').innerText, document.getElementById('clock').textContent]"
    browser.run(f"(() => {{ {scrub.format('0.25 * horizon').replace('clock.time', '')} }})()")
    browser.run(DRAWN)
    before, text_before = browser.run(SEEN), browser.run(state)
    browser.run(f"(() => {{ {scrub.format('0.6 * horizon').replace('clock.time', '')} }})()")
    browser.run(DRAWN)
    after, text_after = browser.run(SEEN), browser.run(state)
    check(abs(browser.run("clock.time / horizon") - 0.6) < 1e-3, "the slider sets the time")
    check(before[1] > 20 and after[1] > 20, f"the picture shows something: {before}, {after}")
    check(before[0] != after[0], "the picture changes with time")
    for name, a, b in zip(["cursor", "values", "clock"], text_before, text_after):
        check(a != b, f"the {name} follows: {a!r}")
    # A click in the plots seeks.
    place = browser.run("(() => { const b = document.querySelector('.area').getBoundingClientRect(); return [b.left + 46 + 0.1 * (b.width - 58), b.top + 40] })()")
    for kind in ["mousePressed", "mouseReleased"]:
        browser.call("Input.dispatchMouseEvent", type=kind, x=place[0], y=place[1], button="left", buttons=1, clickCount=1)
    check(abs(browser.run("clock.time / horizon") - 0.1) < 0.02, "a click in the plots sets the time")
    # Views and layers change the picture.
    seen = browser.run(SEEN)[0]
    for name in ["Top", "Side", "Front"]:
        browser.run(f"[...document.querySelectorAll('.views button')].find((b) => b.textContent === '{name}').click()")
        now = browser.run(SEEN)[0]
        check(now != seen, f"view {name}")
        seen = now
    browser.run("document.querySelectorAll('#layers input').forEach((box) => box.click())")
    check(browser.run(SEEN)[0] != seen, "layers")
    browser.run("document.querySelectorAll('#layers input').forEach((box) => box.click())")
    # Without looping, playback stops at the end.
    browser.run("document.getElementById('loop').click(), document.getElementById('speed').value = 4, "
                "document.getElementById('speed').dispatchEvent(new Event('change')), setTime(0.95 * horizon), setPlaying(true)")
    browser.wait("!clock.playing")
    check(browser.run("clock.time === horizon"), "it plays to the end")
    results = browser.run("data.results.length")
    if results > 1:
        browser.run("document.querySelector('#chips button').click()")
        check(browser.run("panes[0].root.hidden && !panes[1].root.hidden"), "a result can be hidden")
        browser.run("document.querySelector('#chips button').click()")
    # A narrow window has no horizontal scrolling.
    browser.call("Emulation.setDeviceMetricsOverride", width=420, height=800, deviceScaleFactor=1, mobile=False)
    browser.run(DRAWN)
    check(browser.run("document.documentElement.scrollWidth") <= 420, "a narrow window")


def main():
    program = os.environ.get("CHROMIUM") or next((path for name in NAMES if (path := shutil.which(name))), None)
    if program is None:
        print("Chromium is not installed: the page was not opened")
        return 77
    page = pathlib.Path(sys.argv[1]).resolve()
    width, height = map(int, sys.argv[3].split("x")) if len(sys.argv) > 3 else (1280, 800)
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        browser = Browser(program, profile)
        try:
            browser.open(page.as_uri(), width, height)
            if len(sys.argv) > 2:
                at = float(os.environ.get("AT", "0.4"))
                browser.run(f"{os.environ.get('SCRIPT', '0')}, setPlaying(false), setTime({at} * horizon)")
                browser.run(DRAWN)
                pathlib.Path(sys.argv[2]).write_bytes(browser.picture())
            else:
                use(browser)
            check(browser.messages == [], f"messages on the console: {browser.messages}")
            others = [url for url in browser.requests if url != page.as_uri() and not url.startswith(("data:", "blob:"))]
            check(others == [], f"nothing else is loaded: {others}")
        finally:
            browser.close()
    print("the page works")
    return 0


if __name__ == "__main__":
    sys.exit(main())
