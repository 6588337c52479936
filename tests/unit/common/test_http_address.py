import argparse

import pytest

from zsdist.common.http_address import HttpAddress, http_address


@pytest.mark.parametrize(
    ("text", "host", "url"),
    [
        ("9464", "127.0.0.1", "http://127.0.0.1:9464/metrics"),
        ("0.0.0.0:9464", "0.0.0.0", "http://0.0.0.0:9464/metrics"),
        ("[::1]:80", "::1", "http://[::1]:80/metrics"),
    ],
)
def test_an_address_without_a_host_is_this_machines_own(text, host, url):
    found = http_address(text)
    assert found.host == host and found.url("metrics") == url


@pytest.mark.parametrize("text", ["", "0", "65536", "port", "host:", "-1", "1.5", "²"])
def test_anything_else_is_refused_with_what_is_allowed(text):
    with pytest.raises(argparse.ArgumentTypeError, match="allowed is PORT or HOST:PORT"):
        http_address(text)


def test_an_address_is_its_host_and_port():
    assert http_address("a.b:1") == HttpAddress("a.b", 1)
