"""Address at which a command serves a page over HTTP."""

import argparse
from dataclasses import dataclass

LOOPBACK = "127.0.0.1"


@dataclass(frozen=True)
class HttpAddress:
    """Host and port of a server; `LOOPBACK` can be read from this machine only."""

    host: str
    port: int

    def url(self, page: str) -> str:
        """Return the address of a page."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{host}:{self.port}/{page}"


def http_address(text: str) -> HttpAddress:
    """Return the address that an option `[HOST:]PORT` names, on `LOOPBACK` where it names no host."""
    host, _, digits = text.rpartition(":")
    if not (digits.isascii() and digits.isdecimal()) or not 0 < int(digits) < 2**16:
        raise argparse.ArgumentTypeError(f"value is {text!r}; allowed is PORT or HOST:PORT, such as 9464")
    return HttpAddress(host.strip("[]") or LOOPBACK, int(digits))
