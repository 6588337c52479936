"""The live view in Chromium: `make test-browser`. Skipped where Chromium or Playwright is missing.

With `ZSDIST_SCREENSHOTS=FOLDER` pictures of the page are left there to be looked at.
"""

import os
import shutil
import subprocess
import sys
import threading
import time
import urllib.request
from contextlib import closing
from pathlib import Path

import psutil
import pytest
from sockets import free_endpoint

playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed; `make test-browser` does")
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
pytestmark = [pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed"), pytest.mark.timeout(900)]
TESTS = Path(__file__).parents[1]
CARS, MOST_SHARE = 200, 0.05  # of a core
PATIENCE_MS = 240_000
PHONE = {"width": 390, "height": 844}


@pytest.fixture(scope="module")
def monitor():
    """The address of a live view of a made-up run with many cars, and its process."""
    environment = os.environ | {"PYTHONPATH": f"{TESTS.parent}:{TESTS}"}
    port = free_endpoint().rpartition(":")[2]
    made = [sys.executable, str(TESTS / "made_cars.py"), free_endpoint(), str(CARS)]
    with subprocess.Popen(made, stdout=subprocess.PIPE, text=True, env=environment) as cars:
        endpoint = cars.stdout.readline().strip()
        command = [sys.executable, "-m", "zsdist.monitor", "--connect", endpoint, "--run", "demo", "--web", port]
        with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as server:
            assert "live view" in server.stdout.readline()
            yield f"http://127.0.0.1:{port}/", psutil.Process(server.pid)
            server.terminate()
        cars.terminate()


@pytest.fixture(scope="module")
def browser():
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        with closing(browser):
            yield browser


@pytest.fixture
def page(browser, monitor):
    """The page once it shows all cars; nothing but its own server may have been asked, and nothing have failed."""
    page = browser.new_page(viewport={"width": 1280, "height": 900}, color_scheme="light")
    page.set_default_timeout(PATIENCE_MS)
    asked, said = set(), []
    page.on("request", lambda request: asked.add(request.url))
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.goto(monitor[0])
    page.wait_for_selector(f"#tiles label:nth-of-type({CARS})")
    yield page
    page.close()
    assert said == []
    assert {url for url in asked if not url.startswith((monitor[0], "data:"))} == set()


def choose(page):
    page.locator("#tiles input").first.check(force=True)
    page.wait_for_selector("#car-figures div:nth-child(6)", state="attached")


def take(page, name):
    folder = os.environ.get("ZSDIST_SCREENSHOTS")
    if folder:
        page.screenshot(path=Path(folder) / f"monitoring-{name}.png")


def test_a_car_is_chosen_with_the_keyboard_alone(page):
    page.locator("#run").focus()
    for _ in range(30):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.name") == "car":
            break
    page.keyboard.press("ArrowRight")
    page.wait_for_selector("#car-figures div:nth-child(6)", state="attached")
    assert "car 1" in page.inner_text("#car-title")
    page.keyboard.press("ArrowRight")
    page.wait_for_selector("#tiles label:nth-of-type(3) input:checked", state="attached")


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", ["wide", "phone"])
def test_the_page_is_accessible_and_fits(page, scheme, size):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not installed")
    page.emulate_media(color_scheme=scheme)
    if size == "phone":
        page.set_viewport_size(PHONE)
    choose(page)
    page.wait_for_selector("#charts svg path[stroke-linejoin]", state="attached")
    page.locator("#cars").scroll_into_view_if_needed()
    take(page, f"{size}-{scheme}")
    found = axe.Axe().run(page).response["violations"]
    assert [(rule["id"], rule["impact"], rule["nodes"][0]["html"]) for rule in found] == []
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")


def test_a_picture_of_the_car_is_on_its_canvas(page):
    choose(page)
    page.wait_for_selector("#camera[aria-label^='Camera: free']", state="attached")
    script = "(id) => new Set(document.getElementById(id).getContext('2d').getImageData(0, 0, 480, 480).data).size"
    assert all(page.evaluate(script, name) > 20 for name in ("map", "camera"))


def test_many_cars_cost_the_server_little_and_nothing_while_nobody_looks(monitor):
    address, server = monitor

    def share(seconds, look):
        begin, before = time.monotonic(), sum(server.cpu_times()[:2])
        while time.monotonic() < begin + seconds:
            if look:
                urllib.request.urlopen(f"{address}live.json?run=demo&car=actor-3/1", timeout=60).read()
            threading.Event().wait(0.5)
        return (sum(server.cpu_times()[:2]) - before) / (time.monotonic() - begin)

    share(5, look=True)
    watched = share(20, look=True)
    share(8, look=False)
    unwatched = share(10, look=False)
    print(f"share of a core with {CARS} cars: {watched:.3f}; while nobody looks: {unwatched:.4f}")
    assert watched < MOST_SHARE and unwatched < 0.005
