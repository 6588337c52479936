"""`python -m zsdist.monitor`: watch a run from outside, as an ordinary zenoh subscriber."""

import argparse
import json
import time
from pathlib import Path
from typing import NoReturn

from rich.console import Console

from zsdist import config
from zsdist.common import cli
from zsdist.errors import RunError
from zsdist.roles import permissions
from zsdist.run import directory, location
from zsdist.telemetry import watching
from zsdist.telemetry.display import Display
from zsdist.transport.base import Transport
from zsdist.transport.certificates import Identity
from zsdist.transport.zenoh import ZenohTransport


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command's options."""
    parser = cli.Parser(prog="zsdist.monitor", description="Watch a run as a zenoh subscriber.")
    add = parser.add_argument
    add("--connect", metavar="ENDPOINT", help="endpoint of the run's hub, such as tcp/127.0.0.1:7447")
    add("--run", metavar="NAME", help="name of the run, which is that of its folder (default: the hub's only run)")
    add("--runs", type=cli.path, default=Path("runs"), help="folder in which the newest run is watched (default: runs)")
    tls = "folder with ca.pem, monitor.pem and monitor.key, for a hub that asks for certificates"
    add("--tls", metavar="DIR", help=tls)
    add("--once", action="store_true", help="print one snapshot, then exit")
    add("--json", action="store_true", help="with --once: print the snapshot as JSON")
    add("--plain", action="store_true", help="print lines, also on a terminal")
    return parser


def main(options: argparse.Namespace) -> int:
    """Show a run until Ctrl-C, or once."""
    endpoint, run, tls = options.connect, options.run, options.tls
    if endpoint is None:
        folder, run = (_newest_run(options.runs), run) if run is None or "/" not in run else (_run_at(run), None)
        endpoint, run = (folder / "endpoint").read_text(), run or directory.key_name(folder)
        if tls is None and endpoint.startswith("tls/"):
            tls = config.load(folder / "config.yaml").transport.tls
    if tls is None and endpoint.startswith("tls/"):
        raise RunError(f"--tls is needed: the hub at {endpoint} asks for a monitor's certificate")
    transport = ZenohTransport(endpoint, Identity.load(tls, permissions.MONITOR) if tls else None)
    try:
        run = run or watching.only_run(transport, endpoint)
        with Display(run, Console(stderr=options.json), prefer_lines=options.once or options.plain) as display:
            if not options.once:
                _show_live(display, transport)
            _show_once(display, transport, as_json=options.json)
            return 0
    finally:
        transport.close()


def _newest_run(runs: Path) -> Path:
    if (location.find_run(runs) / "endpoint").is_file():  # a run itself
        return location.find_run(runs)
    found = sorted(runs.glob("*/endpoint"), key=lambda path: path.stat().st_mtime)
    if not found:
        raise RunError(f"no run with a hub was found in {runs}; start one, or name --connect ENDPOINT and --run NAME")
    return found[-1].parent


def _run_at(path: str) -> Path:
    """Return the run directory that `--run` names by a path; raise `RunError` where it has no hub."""
    folder = location.find_run(Path(path))
    if not (folder / "endpoint").is_file():
        raise RunError(f"--run {path} is no run directory with a hub; allowed is the name of a run, or its folder")
    return folder


def _show_live(display: Display, transport: Transport) -> NoReturn:
    while True:
        display.refresh(transport, time.time())
        time.sleep(0.1)


def _show_once(display: Display, transport: Transport, *, as_json: bool) -> None:
    snapshot = watching.wait_for_reports(display, transport)
    if as_json:
        print(json.dumps(watching.snapshot_fields(display.run, snapshot), indent=1))
    else:
        display.console.print(display.table())


if __name__ == "__main__":
    cli.execute(main, make_parser())
