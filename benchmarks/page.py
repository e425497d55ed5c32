"""The robot in the page: its size, when the first picture is there, and frames per second while the tip is dragged.

    python -m benchmarks.page

In a headless Chromium without a graphics card, at the sizes of a desktop and of a phone.
"""

from __future__ import annotations

import math
import shutil
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import sync_playwright

from tests.page.serving import FLAGS, build, served

SIZES = {"desktop": (1280, 800, 1), "phone": (390, 844, 2)}
"""Width and height, px, and device pixels per px."""

SECONDS = 5.0
"""Of dragging."""

RECORD = """() => {
    const frame = window.requestAnimationFrame;
    window.busy = [];
    window.times = [];
    window.requestAnimationFrame = (draw) => frame((now) => {
        const begun = performance.now();
        draw(now);
        busy.push(performance.now() - begun);
        times.push(now);
    });
}"""
"""Keeps when frames are drawn, and how long each takes the page, ms."""

TIP = """() => {
    const box = document.getElementById("scene").getBoundingClientRect();
    const at = tubeoptPage.scene.project(tubeoptPage.tip);
    return [at[0] + box.left, at[1] + box.top];
}"""


def measure(browser: Any, address: str, size: tuple[int, int, int]) -> str:
    """First picture and frames while the tip goes around circles, in words."""
    width, height, ratio = size
    page = browser.new_context(viewport={"width": width, "height": height}, device_scale_factor=ratio).new_page()
    page.goto(address)
    page.wait_for_function(
        "() => document.documentElement.dataset.ready && performance.getEntriesByName('picture').length"
    )
    first = page.evaluate("() => performance.getEntriesByName('picture')[0].startTime")
    page.wait_for_timeout(1500)  # compiled code is faster after some use
    page.evaluate(RECORD)
    x, y = page.evaluate(TIP)
    page.mouse.move(x, y)
    page.mouse.down()
    start_time = time.perf_counter()
    while (passed := time.perf_counter() - start_time) < SECONDS:
        page.mouse.move(x + 30 * math.sin(4 * passed), y + 30 * (1 - math.cos(4 * passed)))
        page.wait_for_timeout(8)
    page.mouse.up()
    times, busy = (np.array(page.evaluate(f"() => {name}")) for name in ("times", "busy"))
    steps = np.diff(times)
    steps = steps[steps > 0]
    rate, late = 1e3 / steps.mean(), np.percentile(steps, 95)
    return (
        f"first picture {first:.0f} ms; {rate:.1f} frames/s, 95 % within {late:.1f} ms; "
        f"the page needs {np.median(busy):.1f} ms of a frame (95 %: {np.percentile(busy, 95):.1f})"
    )


def main() -> None:
    """Print what is measured."""
    with tempfile.TemporaryDirectory() as scratch:
        build(Path(scratch))
        files = [file for file in Path(scratch).rglob("*") if file.is_file()]
        print(f"size: {sum(file.stat().st_size for file in files) / 1e3:.0f} kB in {len(files)} files")
        with served(Path(scratch)) as address, sync_playwright() as player:
            browser = player.chromium.launch(executable_path=shutil.which("chromium"), args=FLAGS)
            for name, size in SIZES.items():
                print(f"{name}: {measure(browser, address, size)}")
            browser.close()


if __name__ == "__main__":
    main()
