"""`python -m zsdist.monitor`: watches a run from outside, as a zenoh subscriber like any other."""

import argparse
import json
import time
from pathlib import Path

from rich.console import Console

from zsdist import config
from zsdist.common import cli
from zsdist.errors import RunError
from zsdist.roles import permissions
from zsdist.run import directory
from zsdist.telemetry.display import MAILBOX_BYTES, Display
from zsdist.transport.base import Mailbox
from zsdist.transport.certificates import Identity
from zsdist.transport.zenoh import ZenohTransport
from zsdist.wire import keys

FIRST_WORD_WITHIN_S = 5.0  # every role speaks once a second


def main(options: argparse.Namespace) -> int:
    """Shows a run until Ctrl-C, or once."""
    endpoint, run, tls = options.connect, options.run, options.tls
    if endpoint is None:
        folder = _newest_run(options.runs)
        endpoint, run = (folder / "endpoint").read_text(), run or directory.key_name(folder)
        if tls is None and endpoint.startswith("tls/"):
            tls = config.load(folder / "config.yaml").transport.tls
    if tls is None and endpoint.startswith("tls/"):
        raise RunError(f"--tls is needed: the hub at {endpoint} asks for the certificate of a monitor")
    transport = ZenohTransport(endpoint, Identity.load(tls, permissions.MONITOR) if tls else None)
    try:
        run = run or _only_run(transport, endpoint)
        with Display(run, Console(stderr=options.json), prefer_lines=options.once or options.plain) as display:
            return _once(display, transport, options) if options.once else _live(display, transport)
    finally:
        transport.close()


def parser() -> argparse.ArgumentParser:
    """The command's options."""
    options = cli.Parser(prog="zsdist.monitor", description="Watch a run as a zenoh subscriber.")
    options.add_argument("--connect", metavar="ENDPOINT", help="of the run's hub, such as tcp/127.0.0.1:7447")
    options.add_argument("--run", metavar="NAME", help="the run's name: that of its folder; default: the only one")
    options.add_argument("--runs", type=Path, default=Path("runs"), help="where to look for the newest run")
    options.add_argument(
        "--tls", metavar="DIR", help="folder with ca.pem, monitor.pem and monitor.key, where the hub asks for them"
    )
    options.add_argument("--once", action="store_true", help="one snapshot, then leave")
    options.add_argument("--json", action="store_true", help="with --once: the snapshot as JSON")
    options.add_argument("--plain", action="store_true", help="lines, also on a terminal")
    return options


def _newest_run(runs: Path) -> Path:
    found = sorted(runs.glob("*/endpoint"), key=lambda path: path.stat().st_mtime)
    if not found:
        raise RunError(f"no run with a hub was found in {runs}; start one, or name --connect ENDPOINT and --run NAME")
    return found[-1].parent


def _only_run(transport: ZenohTransport, endpoint: str) -> str:
    """The run at a hub, where there is one and no other."""
    mailbox, names = Mailbox(MAILBOX_BYTES), set()
    transport.watch_alive(keys.alive(keys.ANY, keys.ANY, keys.ANY), mailbox)
    deadline_s = time.monotonic() + FIRST_WORD_WITHIN_S
    while not names and time.monotonic() < deadline_s:
        time.sleep(0.2)
        names = {parsed.run for message in mailbox.drain() if (parsed := keys.parse(message.key)) is not None}
    if len(names) != 1:
        found = ", ".join(sorted(names)) or "none"
        raise RunError(f"--run is needed where a hub does not carry exactly one run; at {endpoint} there is {found}")
    return names.pop()


def _live(display: Display, transport: ZenohTransport) -> int:
    while True:
        display.refresh(transport, time.time())
        time.sleep(0.1)


def _once(display: Display, transport: ZenohTransport, options: argparse.Namespace) -> int:
    """Listens until every living role has spoken."""
    snapshot, deadline_s = display.snapshot, time.monotonic() + FIRST_WORD_WITHIN_S
    while time.monotonic() < deadline_s:
        display.take(transport)
        if snapshot.alive and snapshot.alive <= set(snapshot.roles):
            break
        time.sleep(0.05)
    if not snapshot.roles:
        raise RunError(f"nobody spoke for run {display.run!r} within {FIRST_WORD_WITHIN_S:g} s")
    if options.json:
        told = {
            "run": display.run,
            "alive": sorted("/".join(who) for who in snapshot.alive),
            "figures": snapshot.row(),
            "roles": {"/".join(who): fields for who, fields in sorted(snapshot.roles.items())},
        }
        print(json.dumps(told, indent=1))
    else:
        display.console.print(display.table())
    return 0


if __name__ == "__main__":
    cli.execute(main, parser())
