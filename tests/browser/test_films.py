"""A film in a real browser: `make test-browser`. Skipped where there is no Chromium."""

import shutil
import subprocess
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from zsdist.reporting import film_file

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
PAGE = """<!doctype html><title>film</title><video id="film" src="film.mp4" muted autoplay playsinline></video><script>
const film = document.getElementById("film");
film.addEventListener("playing", () => fetch("/said/playing-" + film.videoWidth + "x" + film.videoHeight));
film.addEventListener("error", () => fetch("/said/error-" + film.error.code));
</script>"""
pytestmark = [pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed"), pytest.mark.timeout(300)]


class Handler(SimpleHTTPRequestHandler):
    said, heard = "", threading.Event()

    def do_GET(self):
        if not self.path.startswith("/said/"):
            super().do_GET()
            return
        Handler.said = self.path.removeprefix("/said/")
        Handler.heard.set()
        self.send_response(204)
        self.end_headers()

    def log_message(self, *words):
        pass


def test_a_browser_plays_a_film(tmp_path):
    pictures = (np.full((558, 1452, 3), 5 * number, np.uint8) for number in range(30))
    film_file.write(pictures, tmp_path / "film.mp4", still=1)
    (tmp_path / "index.html").write_text(PAGE)
    with ThreadingHTTPServer(("127.0.0.1", 0), partial(Handler, directory=str(tmp_path))) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        options = ("--headless=new", "--no-sandbox", "--disable-gpu", "--autoplay-policy=no-user-gesture-required")
        place = f"--user-data-dir={tmp_path / 'profile'}"
        page = f"http://127.0.0.1:{server.server_port}/index.html"
        with subprocess.Popen([CHROMIUM, *options, place, page], stderr=subprocess.DEVNULL) as browser:
            Handler.heard.wait(240)
            browser.terminate()
        server.shutdown()
    assert Handler.said == "playing-1452x558"
