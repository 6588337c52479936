import json
import re
from http.client import HTTPConnection
from importlib import resources

import pytest

from zsdist.common.http_address import LOOPBACK, HttpAddress
from zsdist.errors import RunError
from zsdist.web.server import WebServer

ASSETS = {file.name: file.read_text() for file in resources.files("zsdist.web").joinpath("assets").iterdir()}


class Shown:
    """Source that shows what it was asked for."""

    def runs(self):
        return {"first": "a", "runs": []}

    def live(self, run, car):
        return json.dumps({"run": run, "car": car}).encode()

    def compare(self, runs):
        return {"runs": runs}

    def snapshot(self, run):
        raise RunError(f"run {run} has no hub yet")


@pytest.fixture
def server():
    with WebServer(HttpAddress(LOOPBACK, 0), Shown()) as server:
        yield server


def ask(server, path, method="GET", **headers):
    connection = HTTPConnection(LOOPBACK, server.where.port, timeout=10)
    connection.request(method, path, headers={name.replace("_", "-"): value for name, value in headers.items()})
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer, body


@pytest.mark.parametrize("name", ["", *ASSETS])
def test_the_page_and_its_files_are_served_under_a_strict_policy(server, name):
    answer, body = ask(server, f"/{name}")
    assert answer.status == 200 and body.decode() == ASSETS[name or "index.html"]
    policy = answer.headers["Content-Security-Policy"]
    assert policy.startswith("default-src 'none'; script-src 'self'; style-src 'self';") and "unsafe" not in policy
    assert answer.headers["X-Content-Type-Options"] == "nosniff"
    assert ("javascript" in answer.headers["Content-Type"]) == name.endswith(".js")


@pytest.mark.parametrize(
    ("path", "content"),
    [
        ("/runs.json", {"first": "a", "runs": []}),
        ("/live.json?run=my%20run&car=actor-0/2", {"run": "my run", "car": "actor-0/2"}),
        ("/live.json", {"run": "", "car": ""}),
        ("/compare.json?run=a&run=b", {"runs": ["a", "b"]}),
        ("/compare.json?" + "run=a&" * 100, {"runs": ["a"] * 8}),
    ],
)
def test_what_the_page_asks_for_is_json(server, path, content):
    answer, body = ask(server, path)
    assert answer.status == 200 and json.loads(body) == content


def test_an_error_is_said_in_json(server):
    answer, body = ask(server, "/snapshot.json?run=x")
    assert answer.status == 503 and json.loads(body) == {"error": "run x has no hub yet"}


@pytest.mark.parametrize("host", ["evil.example", "evil.example:8090", "127.0.0.1.evil.example", "192.168.0.7", ""])
def test_a_name_that_was_made_to_point_to_this_machine_is_refused(server, host):
    for path in ("/", "/live.json", "/app.js"):
        answer, body = ask(server, path, Host=host)
        assert answer.status == 403 and b"127.0.0.1" in body


@pytest.mark.parametrize("host", ["localhost", "localhost:9000", "127.0.0.1:9000", "[::1]:9000", "LOCALHOST:1"])
def test_a_browser_at_the_other_end_of_a_tunnel_is_answered(server, host):
    assert ask(server, "/runs.json", Host=host)[0].status == 200


@pytest.mark.parametrize("site", ["cross-site", "same-site"])
def test_another_site_may_link_to_the_page_and_ask_for_nothing(server, site):
    assert ask(server, "/runs.json", Sec_Fetch_Site=site, Sec_Fetch_Mode="cors")[0].status == 403
    assert ask(server, "/", Sec_Fetch_Site=site, Sec_Fetch_Mode="navigate")[0].status == 200


@pytest.mark.parametrize("path", ["/none", "/../server.py", "/%2e%2e/server.py", "//etc/passwd", "/assets/app.js"])
def test_only_the_files_of_the_page_are_there(server, path):
    assert ask(server, path)[0].status == 404


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS"])
def test_nothing_can_be_changed(server, method):
    assert ask(server, "/runs.json", method)[0].status == 501


def test_the_head_of_a_file_comes_without_it(server):
    answer, body = ask(server, "/app.js", "HEAD")
    assert answer.status == 200 and body == b"" and int(answer.headers["Content-Length"]) > 1000


def test_a_port_that_is_taken_is_said_in_one_line(server):
    with pytest.raises(RunError, match=f"cannot be served at http://127.0.0.1:{server.where.port}/"):
        WebServer(HttpAddress(LOOPBACK, server.where.port), Shown())


def test_the_page_names_nothing_outside_and_nothing_that_its_policy_forbids():
    for name, text in ASSETS.items():
        assert set(re.findall(r"https?://[^\s\"']+", text)) <= {"http://www.w3.org/2000/svg"}, name
    page = ASSETS["index.html"]
    assert not re.search(r"\sstyle=|\son[a-z]+=|<style|<script(?![^>]*src=)", page)
    assert set(re.findall(r'(?:src|href)="([a-z]+\.(?:js|css|svg))"', page)) <= set(ASSETS)
    html = re.compile(r"innerHTML|outerHTML|insertAdjacentHTML|document\.write|eval\(")
    assert [name for name, text in ASSETS.items() if html.search(text)] == []


def test_modules_import_only_each_other():
    for name, text in ASSETS.items():
        if name.endswith(".js"):
            assert {file for file in re.findall(r'from "(.*?)"', text)} <= {f"./{other}" for other in ASSETS}, name
