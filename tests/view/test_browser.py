"""The page of the live view in a real browser, without a display."""

from __future__ import annotations

import importlib.util
import io
import shutil
import threading
import time

import numpy as np
import pytest
from PIL import Image

from ppt_rl import load_policy
from ppt_rl.view import LiveView

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
MISSING = [name for name in ("viser", "playwright") if importlib.util.find_spec(name) is None]
#: What lets a browser draw without a graphics card.
FLAGS = ["--no-sandbox", "--ignore-gpu-blocklist", "--enable-unsafe-swiftshader", "--use-angle=swiftshader"]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(bool(MISSING), reason=f"not installed: {MISSING}"),
    pytest.mark.skipif(BROWSER is None, reason="no Chromium is installed"),
]


@pytest.fixture
def page():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as play:
        browser = play.chromium.launch(executable_path=BROWSER, args=FLAGS)
        yield browser.new_page(viewport={"width": 1280, "height": 760})
        browser.close()


@pytest.fixture
def view():
    view = LiveView(load_policy("ppt_push").with_changes(num_threads=1), port=18_090, seed=10_000)
    thread = threading.Thread(target=view.run)
    thread.start()
    yield view
    view.close()
    thread.join(60)
    assert not thread.is_alive()
    view.episodes.free()


def wait_for(condition, seconds=90.0):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it did not happen in time"
        time.sleep(0.1)


def test_the_page_shows_the_scene_and_its_controls_work(view, page, tmp_path):
    page.goto(view.url, timeout=120_000)
    page.get_by_text("power limit [W]").wait_for(timeout=120_000)
    page.get_by_text("Episode").first.wait_for(timeout=120_000)
    page.wait_for_timeout(8_000)
    picture = page.screenshot(path=tmp_path / "live_view.png", timeout=120_000)
    pixels = np.asarray(Image.open(io.BytesIO(picture)).convert("RGB")).astype(int)
    red, green, blue = pixels[150:, :860].reshape(-1, 3).T
    assert ((red > 150) & (green < 130) & (blue < 90)).sum() > 50  # the box
    assert ((blue > 100) & (blue - red > 40)).sum() > 20  # the tool, or the obstacle

    field = page.locator("input[type=text]").nth(1)  # the first is the speed
    field.fill("0.5")
    field.press("Enter")
    wait_for(lambda: view.episodes.settings.get("p_max") == pytest.approx(0.5, abs=0.02))
    wait_for(lambda: view.episodes.present.config.p_max == pytest.approx(0.5, abs=0.02))

    page.get_by_role("button", name="pause").click(timeout=120_000)
    wait_for(lambda: view.episodes.paused)
    frames = view.frames
    page.get_by_role("button", name="go on").click(timeout=120_000)
    wait_for(lambda: not view.episodes.paused and view.frames > frames)
    number = view._number
    page.get_by_role("button", name="reset").click(timeout=120_000)
    wait_for(lambda: view._number > number)
