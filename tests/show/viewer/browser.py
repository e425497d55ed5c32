"""A real, headless Chromium without a graphics card, and what tests do on the viewer's page."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from tubeopt.show.viewer import View, serve
from tubeopt.typing import Array

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")

FLAGS = [
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-dev-shm-usage",
    "--disable-gpu-compositing",  # one that is imitated takes a third of the time of a page
]

LITTLE_DRAWING = """
const drawing = WebGL2RenderingContext.prototype, drawElements = drawing.drawElements;
window.draw = on => { drawing.drawElements = on ? drawElements : () => {} };
window.draw(false);
drawing.drawArrays = () => {};
window.requestAnimationFrame = draw => window.setTimeout(() => draw(performance.now()), 100);
window.cancelAnimationFrame = window.clearTimeout;
document.addEventListener("DOMContentLoaded", () => {
    const style = document.createElement("style");
    style.textContent = "*:has(> canvas) { max-width: 100px !important; max-height: 100px !important }";
    document.head.append(style);
});
"""
"""Drawing by software would be most of what a page costs: the scene is kept, small, with ten frames in a second, and is
drawn only where a test asks for it by `Tab.draw`, without the light of its surroundings, whose preparation alone takes
4 s, as the one thing that is drawn without an index of vertices."""

PATIENCE = 120_000
"""Longest wait, ms: ten times what it takes, since others may keep the processor busy."""


@contextmanager
def served(view: View, **options: Any) -> Iterator[str]:
    """The address of a page that shows a view."""
    address: list[str] = []
    ready, stop = threading.Event(), threading.Event()

    def tell(url: str) -> None:
        address.append(url)
        ready.set()

    thread = threading.Thread(target=serve, args=(view,), kwargs={"port": 0, "ready": tell, "stop": stop, **options})
    thread.start()
    try:
        assert ready.wait(PATIENCE / 1e3)
        yield address[0]
    finally:
        stop.set()
        thread.join(PATIENCE / 1e3)
        assert not thread.is_alive()


class Tab:
    """A tab with the viewer's page."""

    def __init__(self, context: Any, address: str) -> None:
        self.page = context.new_page()
        self.page.set_default_timeout(PATIENCE)
        self.page.goto(address)
        # That drawing by software is slow is not for tests to be told, least of all over the buttons.
        self.page.add_style_tag(content=".mantine-Notifications-root { display: none !important }")
        self.page.bring_to_front()
        self.page.wait_for_selector("[data-testid=tip]")
        self.wait_for("certificate", "certificate \N{MINUS SIGN}", "certificate 0")

    def read(self, name: str) -> str:
        """The text of a part of the readout."""
        return str(self.page.locator(f"[data-testid={name}]").first.inner_text())

    def sees(self, name: str) -> bool:
        """Whether a part of the readout is what stands where it is, within the window."""
        observed = """name => {
            const part = document.querySelector(`[data-testid=${name}]`), box = part.getBoundingClientRect();
            return part.contains(document.elementFromPoint(box.left + box.width / 2, box.top + box.height / 2));
        }"""
        return bool(self.page.evaluate(observed, name))

    @property
    def tip(self) -> Array:
        """(3,) m as it is read."""
        return np.array([float(x) for x in self.read("tip").split(",")]) * 1e-3

    def wait_for(self, name: str, *texts: str) -> str:
        """Wait until a part of the readout holds one of some texts."""
        self.page.wait_for_function(
            "([name, texts]) => [...document.querySelectorAll(`[data-testid=${name}]`)]"
            ".some(e => texts.some(t => e.innerText.includes(t)))",
            arg=[name, list(texts)],
            polling=100,
        )
        return self.read(name)

    def wait_for_tip(self, tip: Array) -> None:
        """Wait until the tip reads so, to the last digit that is written."""
        self.page.wait_for_function(
            "tip => document.querySelector('[data-testid=tip]').innerText.split(',')"
            ".every((x, k) => Math.abs(parseFloat(x) - tip[k]) < 1.01e-4)",
            arg=[float(x) * 1e3 for x in tip],
            polling=100,
        )

    def tab(self, name: str) -> None:
        """Turn to a page of the controls."""
        self.page.get_by_role("tab", name=name, exact=True).click()

    def _send(self) -> None:
        """Wait until what was typed is sent: viser bundles that over 50 ms, by the clock of the page."""
        self.page.evaluate("() => new Promise(done => window.setTimeout(done, 100))")

    def wait_until_at_rest(self) -> None:
        """Wait until the tip reads the same for a while."""
        current = self.tip
        for _ in range(PATIENCE // 1000):
            self.page.wait_for_timeout(1000)
            before, current = current, self.tip
            if np.array_equal(before, current):
                return
        raise AssertionError("the tip does not come to rest")

    def press(self, label: str) -> None:
        """Press a button, after what was typed is sent."""
        self._send()
        self.page.get_by_role("button", name=label, exact=True).click()

    def box(self, label: str) -> Any:
        """The number box with this label."""
        row = self.page.locator("label", has_text=label).locator("xpath=ancestor::*[.//input][1]")
        return row.locator("input").last

    def type(self, label: str, value: float | str) -> None:
        """Write into a number box."""
        self.box(label).fill(str(value))
        self._send()

    def wait_for_box(self, label: str, value: str) -> None:
        """Wait until a number box holds this."""
        self.page.wait_for_function(
            "([box, value]) => box.value === value", arg=[self.box(label).element_handle(), value], polling=100
        )

    def wait_for_more(self, label: str, value: float) -> None:
        """Wait until the number in a box is more than this."""
        box = self.box(label).element_handle()
        self.page.wait_for_function("([box, value]) => parseFloat(box.value) > value", arg=[box, value], polling=50)

    def upload(self, label: str, path: Path) -> None:
        """Give a file to a button that loads one."""
        with self.page.expect_file_chooser() as waiting:
            self.press(label)
        waiting.value.set_files(path)

    def draw(self, on: bool) -> None:
        """Begin or end to draw the scene."""
        self.page.evaluate("on => window.draw(on)", on)

    def download(self, label: str) -> bytes:
        """What a button saves."""
        with self.page.expect_download() as waiting:
            self.press(label)
        path = waiting.value.path()
        with open(path, "rb") as file:
            return file.read()
