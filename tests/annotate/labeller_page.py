"""A labelling server in a process of its own, and a tab of a real Chromium in terms of the image."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time

from kt3dmoseg.annotate import load_annotation

LIMIT = 60.0
CORNERS = [(60, 70), (140, 70), (140, 130), (60, 130)]


class Server:
    """`kt3dmoseg label` as a process of its own."""

    def __init__(self, clips, notes, port=0, *extra):
        command = [sys.executable, "-m", "kt3dmoseg", "label", str(clips / "frames"), "--no-browser"]
        command += [
            "--tracks",
            str(clips / "tracks"),
            "--annotations",
            str(notes),
            "--port",
            str(port),
            *extra,
        ]
        environment = os.environ | {"OMP_NUM_THREADS": "1"}
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
        watchdog = threading.Timer(LIMIT, self.process.kill)  # a server that never answers ends the loop
        watchdog.start()
        for line in self.process.stdout:
            if found := re.search(r"http://\S+:(\d+)/\S*", line):
                watchdog.cancel()
                self.address, self.port = found.group(0), int(found.group(1))
                return
        watchdog.cancel()
        raise AssertionError("the server did not start")

    def stop(self, how=signal.SIGINT):
        if self.process.poll() is None:
            self.process.send_signal(how)
        self.process.wait(timeout=LIMIT)
        self.process.stdout.close()


class Page:
    """A tab, in terms of the image."""

    def __init__(self, context, address):
        self.tab = context.new_page()
        self.errors = []
        self.tab.on("pageerror", lambda error: self.errors.append(str(error)))
        self.tab.goto(address)
        self.ready()

    def ready(self):
        self.until("window.labeller?.state.labels && labeller.state.loaded")

    def value(self, expression):
        return self.tab.evaluate(f"() => {expression}")

    def until(self, expression, limit=LIMIT):
        end = time.monotonic() + limit
        while not self.value(f"!!({expression})"):
            assert time.monotonic() < end, (expression, self.errors)
            time.sleep(0.02)

    def shows(self, selector, text=""):
        """Wait until an element is to be seen, with that text somewhere in it."""
        self.tab.locator(selector).filter(has_text=text).first.wait_for()

    def box(self, selector):
        """Where an element is, measured in one step of the page: it may be drawn again at any time."""
        self.until(f"document.querySelector('{selector}')")
        return self.value(
            f"(({{ x, y, width, height }}) => ({{ x, y, width, height }}))"
            f"(document.querySelector('{selector}').getBoundingClientRect())"
        )

    def at(self, point):
        box = self.box("#stage")
        view = self.value("labeller.state.view")
        return [box[k] + (point[i] - view[k]) * view["scale"] for i, k in enumerate("xy")]

    def click(self, point, **options):
        self.tab.mouse.click(*self.at(point), **options)

    def hold(self, start, *stops, steps=4):
        """Press the mouse on a place and move it to others, without letting go."""
        self.tab.mouse.move(*self.at(start))
        self.tab.mouse.down()
        for stop in stops:
            self.tab.mouse.move(*self.at(stop), steps=steps)

    def release(self, stop, steps=4):
        """Move the mouse that is held to a place, and let go."""
        self.tab.mouse.move(*self.at(stop), steps=steps)
        self.tab.mouse.up()

    def drag(self, start, *stops, steps=4):
        self.hold(start, *stops, steps=steps)
        self.tab.mouse.up()

    def press(self, *keys):
        for key in keys:
            self.tab.keyboard.press(key)

    def draw(self, corners=CORNERS):
        self.press("n")
        for corner in corners:
            self.click(corner)
        self.press("Enter")

    def objects(self):
        return self.value("labeller.state.doc.objects")

    def settle(self):
        """Wait until no save is on its way, nor will be by itself."""
        if not self.tab.is_closed():
            still = "labeller.state.dragging || ['offline', 'failed'].includes(labeller.state.saving.kind)"
            idle = "labeller.state.saving.kind !== 'busy' && !labeller.saver.pending"
            self.until(f"!window.labeller?.saver.base || {still} || ({idle})")

    def saved(self):
        """Wait until everything is saved; return the revision in view."""
        self.until("labeller.state.saving.kind === 'saved' && !labeller.saver.pending")
        self.until("document.getElementById('saved').textContent.includes('rev ')")
        return int(re.search(r"rev (\d+)", self.tab.locator("#saved").inner_text()).group(1))


def stored(server, clip="one"):
    return load_annotation(server.notes / f"{clip}.json")


def near(polygon, corners, reach=1.0):
    return len(polygon) == len(corners) and all(
        abs(x - a) < reach and abs(y - b) < reach for (x, y), (a, b) in zip(polygon, corners, strict=True)
    )
