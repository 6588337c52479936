"""Settings for access to the hub, and paths in settings."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from zsdist.config import dump, load, parse
from zsdist.errors import ConfigError


@pytest.mark.parametrize("endpoint", ["tcp/127.0.0.1:7447", "tcp/127.8.9.1:1", "tcp/localhost:7447", "tcp/[::1]:7447"])
def test_without_certificates_a_loopback_endpoint_is_allowed(endpoint):
    assert load(None, (f"transport.endpoint={endpoint}",)).transport.endpoint == endpoint


@pytest.mark.parametrize(
    "endpoint",
    ["tcp/10.0.0.1:7447", "tcp/0.0.0.0:7447", "tcp/[::]:7447", "tcp/127.example.com:7447", "tcp/localhost.example:1"],
)
def test_without_certificates_any_other_endpoint_is_refused_in_one_line_that_says_what_to_do(endpoint):
    with pytest.raises(ConfigError) as refused:
        load(None, (f"transport.endpoint={endpoint}",))
    assert endpoint in str(refused.value) and "zsdist.certs" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_with_certificates_the_default_endpoint_is_tls_and_any_host_is_allowed():
    assert load(None, ("transport.tls=made",)).transport.endpoint == "tls/127.0.0.1:7447"
    remote = ("transport.tls=made", "transport.endpoint=tls/10.0.0.1:7447", "run.address=auto")
    assert load(None, remote).transport.endpoint == "tls/10.0.0.1:7447"


@pytest.mark.parametrize(
    "overrides",
    [
        ("transport.tls=made", "transport.endpoint=tcp/127.0.0.1:7447"),
        ("transport.endpoint=tls/127.0.0.1:7447",),
        ("transport.tls=''",),
    ],
)
def test_tls_without_its_endpoint_and_the_reverse_are_refused(overrides):
    with pytest.raises(ConfigError, match="transport"):
        load(None, overrides)


def test_the_folder_of_certificates_is_kept_as_an_absolute_path(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    config = load(None, ("transport.tls=made",))
    assert Path(config.transport.tls) == tmp_path / "made"
    (tmp_path / "again.yaml").write_text(dump(config))
    assert load(tmp_path / "again.yaml") == config == parse(config.model_dump())


def test_paths_become_absolute_and_names_stay_as_they_are(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    settings = load(overrides=("scenes.train=[iid, sc/good]", "scenes.test=[./iid]", "vision.weights=runs/eyes"))
    assert settings.scenes.train == ("iid", str(tmp_path / "sc" / "good"))
    assert settings.scenes.test == (str(tmp_path / "iid"),)
    assert (settings.vision.weights, settings.vision.encoder) == (
        str(tmp_path / "runs" / "eyes"),
        "efficientnet-lite0",
    )


def test_a_file_is_utf_8_in_every_locale(tmp_path):
    file = tmp_path / "run.yaml"
    file.write_text("# größere Läufe\nrun: {episodes: 7}\n", encoding="utf-8")
    command = [sys.executable, "-c", f"from zsdist import config; print(config.load({str(file)!r}).run.episodes)"]
    ascii_only = os.environ | {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    assert subprocess.run(command, capture_output=True, text=True, env=ascii_only, check=True).stdout.strip() == "7"
