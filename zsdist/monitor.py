"""`python -m zsdist.monitor`: watch a run from outside, as an ordinary zenoh subscriber."""

import argparse
import contextlib
import json
import threading
import time
from contextlib import closing
from pathlib import Path

from zsdist.common import cli, output_files
from zsdist.common.console import PlainConsole, say
from zsdist.common.http_address import LOOPBACK, HttpAddress, http_address
from zsdist.errors import RunError, TransportError
from zsdist.roles import permissions
from zsdist.run import life as lives
from zsdist.run import program
from zsdist.run.life import RunLife
from zsdist.telemetry import history, watching
from zsdist.telemetry.curves import CurveHistory
from zsdist.telemetry.display import MAILBOX_BYTES, Display
from zsdist.telemetry.watching import Sight
from zsdist.transport.base import Mailbox, Transport
from zsdist.transport.certificates import Identity
from zsdist.transport.zenoh import ZenohTransport
from zsdist.wire import keys

LOST = 1  # exit status: the run is gone without having ended
STARTS_WITHIN_S = 180.0  # time from the folder of a run to its hub
LOOK_EVERY_S = 0.5
WEB_PORT = 8090


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command's options."""
    parser = cli.Parser(prog="zsdist.monitor", description="Watch a run as a zenoh subscriber.")
    add = parser.add_argument
    add("--connect", metavar="ENDPOINT", help="endpoint of the run's hub, such as tcp/127.0.0.1:7447")
    add(
        "--run", metavar="NAME", help="name of the run, which is that of its folder (default: the newest, or the hub's)"
    )
    add("--runs", type=cli.path, default=Path("runs"), help="folder in which the run is looked for (default: runs)")
    tls = "folder with ca.pem, monitor.pem and monitor.key, for a hub that asks for certificates"
    add("--tls", metavar="DIR", help=tls)
    add("--wait", action="store_true", help="where no run is alive, wait for the next one to start")
    add("--once", action="store_true", help="print one snapshot, then exit")
    add("--json", action="store_true", help="with --once: print the snapshot as JSON")
    add("--plain", action="store_true", help="print lines, also on a terminal")
    metrics = "serve the figures to Prometheus at 127.0.0.1:PORT or HOST:PORT, of one run after the other"
    add("--prometheus", type=http_address, metavar="PORT", help=metrics)
    add("--rerun", metavar="FILE.rrd", help="record one car for the Rerun viewer, or show it there: live")
    add("--car", type=_car, default="actor-0/0", metavar="ACTOR/CAR", help="car to record (default: actor-0/0)")
    web = f"show runs in a browser on this machine, at 127.0.0.1:PORT (default: {WEB_PORT})"
    add("--web", type=_port, nargs="?", const=WEB_PORT, metavar="PORT", help=web)
    return parser


def main(options: argparse.Namespace) -> int:
    """Show a run until it ends or until Ctrl-C, or once; return 1 where it is gone without having ended."""
    if options.prometheus is not None:
        return _export(options)
    if options.web is not None:
        return _serve_pages(options)
    if options.rerun is not None:
        return _record_car(options)
    if options.wait and (other := _first_given(options, "once", "connect", "run")) is not None:
        raise RunError(f"--{other} cannot be combined with --wait, which takes the next run that starts")
    if options.connect is None:
        return _watch_folder(options, _await_run(options) if options.wait else lives.find(options.runs, options.run))
    with closing(_connect(options.connect, options.tls)) as transport:
        run = options.run or watching.only_run(transport, options.connect)
        display = Display(run, PlainConsole(stderr=options.json), prefer_lines=options.once or options.plain)
        sight = _watch(options, display, transport)
    seen = "was not seen" if display.heard_s is None else f"was last seen at {lives.clock(display.heard_s)}"
    if sight is Sight.GONE:
        say(f"run {run} {seen}: it ended or was killed, or it cannot be reached from here", error=True)
        return LOST
    if sight is Sight.ENDED:
        say(f"run {run} ended; it {seen}", error=options.json)
    return 0


def _export(options: argparse.Namespace) -> int:
    """Serve the metrics of one run after the other, until a signal; a run that is not there yet is waited for."""
    _require_alone(options, "prometheus")
    if options.connect is not None:
        _identity(options.connect, options.tls)  # what is wrong with the certificate is said at once
    from zsdist.telemetry import prometheus

    with prometheus.Exporter(options.prometheus) as exporter:
        say(f"metrics at {options.prometheus.url(prometheus.PAGE)}")
        exporter.serve(lambda: _find(options))
    return 0


def _serve_pages(options: argparse.Namespace) -> int:
    """Show runs in a browser, until a signal."""
    _require_alone(options, "web")
    if options.connect is not None:
        _identity(options.connect, options.tls)  # what is wrong with the certificate is said at once
    from zsdist.web.server import WebServer
    from zsdist.web.source import RunsSource

    source = RunsSource(lambda life: _open_run(options, life), options.runs, options.run, options.connect or "")
    with WebServer(HttpAddress(LOOPBACK, options.web), source) as server:
        port = server.where.port
        say(f"live view at {server.where.url('')}; Ctrl-C ends it, which no run notices")
        say(f"from another machine: ssh -N -L {port}:{LOOPBACK}:{port} USER@THIS_MACHINE, then the same address there")
        threading.Event().wait()
    return 0


def _record_car(options: argparse.Namespace) -> int:
    """Record what one car sees, believes and does, until a signal or until it is silent."""
    _require_alone(options, "rerun")
    from zsdist.reporting import rerun_frames, rerun_log
    from zsdist.web.attention import Attention
    from zsdist.web.live import ANSWER_WITHIN_S, EVERY_S, read_answer

    rerun_log.require_rerun()
    target: Path | str = options.rerun if options.rerun == rerun_log.LIVE else cli.path(options.rerun)
    if isinstance(target, Path):
        output_files.check_place("--rerun", target)
    run, transport = _find(options)
    attend = Attention(lambda: lives.find(options.runs, options.run).settings())
    answers, last, heard_s = Mailbox(MAILBOX_BYTES), None, time.monotonic()
    with closing(transport), rerun_log.RerunLog(target) as log:
        say(f"car {options.car} of run {run} is recorded into {options.rerun}; Ctrl-C ends it, which no run notices")
        while time.monotonic() - heard_s < watching.GONE_AFTER_S:
            transport.request(keys.view(run, *options.car.split("/")), b"", answers, timeout_s=ANSWER_WITHIN_S)
            time.sleep(EVERY_S)
            for message in answers.drain():
                if (view := read_answer(message.payload)) is None:
                    continue
                heard_s = time.monotonic()
                now = view.get("kind"), view.get("number"), view.get("step")
                if now != last and (frame := rerun_frames.frame_of_view(view | attend(view))) is not None:
                    last = now
                    log.add(frame)
    say(f"car {options.car} of run {run} does not answer any more; the run ended, or has no such car", error=True)
    return LOST


def _require_alone(options: argparse.Namespace, mode: str) -> None:
    """Raise an error where an option of what is shown here, or of another mode, was given beside a mode."""
    others = (name for name in ("once", "json", "plain", "wait", "rerun", "web") if name != mode)
    if (other := _first_given(options, *others)) is not None:
        raise RunError(f"--{other} cannot be combined with --{mode}, which shows nothing here")


def _first_given(options: argparse.Namespace, *names: str) -> str | None:
    """Return the first of some options that was given; None where none was."""
    return next((name for name in names if getattr(options, name) not in (None, False)), None)


def _await_run(options: argparse.Namespace) -> RunLife:
    """Return the newest run that is alive, which may start only later."""
    told = False
    while True:
        with contextlib.suppress(RunError):
            life = lives.find(options.runs)
            if life.runs:
                return life
        if not told:
            told = True
            say(f"no run is alive in {options.runs}; waiting for the next one to start", error=options.json)
        time.sleep(LOOK_EVERY_S)


def _find(options: argparse.Namespace) -> tuple[str, Transport]:
    """Return the name of a run that goes on and a connection to its hub; raise an error where there is none."""
    return _open_run(options, None if options.connect is not None else lives.find(options.runs, options.run))


def _open_run(options: argparse.Namespace, life: RunLife | None) -> tuple[str, Transport]:
    """Return the name of a run and a connection to its hub; None stands for the hub that `--connect` names."""
    if life is None:
        transport = _connect(options.connect, options.tls)
        try:
            return options.run or watching.only_run(transport, options.connect), transport
        except RunError:
            transport.close()
            raise
    if life.ended or life.killed:
        raise RunError(f"run {life.title} has ended or was killed")
    reached = _reach(options, life)
    if reached is None:
        raise RunError(f"run {life.title} is starting, or its hub does not answer")
    return life.name, reached


def _watch_folder(options: argparse.Namespace, life: RunLife) -> int:
    """Show the run in a folder until its end, wherever its hub moves."""
    watched, silent_from_s = False, None  # monotonic time from which on no hub was reached
    while not life.ended:
        if life.killed:
            return _say_lost(options, life)
        transport = _reach(options, life)
        if transport is not None:
            watched, silent_from_s = True, None
            console = PlainConsole(stderr=options.json)
            lines = options.once or options.plain
            display = Display(
                life.name,
                console,
                title=life.title,
                prefer_lines=lines,
                started_s=life.started_s,
                expected=program.reporting(life.settings()),
                history=CurveHistory(history.curves(life.folder)),
            )
            with closing(transport):
                sight = _watch(options, display, transport, life)
            if sight is Sight.ONCE:
                return 0
            life = lives.read(life.folder)
            if sight is Sight.GONE and not life.ended:
                return _say_lost(options, life)
            continue
        if silent_from_s is None:
            silent_from_s = time.monotonic()
            if not options.once:
                what = "is starting" if life.endpoint is None else f"does not answer at {life.endpoint}"
                say(f"run {life.title} {what}; waiting for its hub", error=options.json)
        _check_patience(options, life, time.monotonic() - silent_from_s)
        if time.time() - life.seen_s > (STARTS_WITHIN_S if life.endpoint is None else watching.GONE_AFTER_S):
            return _say_lost(options, life)
        time.sleep(LOOK_EVERY_S)
        life = lives.read(life.folder)
    if options.once and options.json:
        print(json.dumps(life.fields(), indent=1))
    else:
        hint = "; --wait waits for the next run" if options.run is None and not (watched or options.once) else ""
        say(life.farewell() + hint, error=options.json)
    return 0


def _check_patience(options: argparse.Namespace, life: RunLife, silent_s: float) -> None:
    """Raise an error where a run that is alive is not waited for: with `--once`, or after a while."""
    if not life.runs:
        return
    if life.endpoint is not None and (options.once or silent_s > watching.GONE_AFTER_S):
        raise TransportError(
            f"run {life.title} runs, but no hub answers at {life.endpoint}, or it refuses this monitor"
        )
    if options.once:
        raise RunError(f"run {life.title} is starting and has no hub yet; try again in some seconds")


def _reach(options: argparse.Namespace, life: RunLife) -> ZenohTransport | None:
    """Return a connection to the hub of a run; None where there is no hub yet, or where it does not answer.

    Raises:
        RunError: the run has no hub.
        TransportError: the monitor's certificate cannot be used.
    """
    settings = life.settings().transport
    if settings.kind == "memory":
        raise RunError(
            f"run {life.title} in {life.folder} runs in one process without a hub and cannot be watched; its figures "
            "are in metrics.jsonl"
        )
    if life.endpoint is None:
        return None
    identity = _identity(life.endpoint, options.tls or settings.tls)
    try:
        return ZenohTransport(life.endpoint, identity)
    except TransportError:
        return None


def _connect(endpoint: str, tls: str | None) -> ZenohTransport:
    return ZenohTransport(endpoint, _identity(endpoint, tls))


def _identity(endpoint: str, tls: str | None) -> Identity | None:
    if tls is None and endpoint.startswith("tls/"):
        raise RunError(f"--tls is needed: the hub at {endpoint} asks for a monitor's certificate")
    return Identity.load(tls, permissions.MONITOR) if tls else None


def _watch(options: argparse.Namespace, display: Display, transport: Transport, life: RunLife | None = None) -> Sight:
    """Show a run once, or until it is out of sight."""
    with display:
        if options.once:
            snapshot = watching.wait_for_reports(display, transport)
            if options.json:
                print(json.dumps(watching.snapshot_fields(display.run, snapshot), indent=1))
            else:
                display.console.print(display.table())
            return Sight.ONCE
        return watching.follow(display, transport, lambda: _moved(life))


def _moved(life: RunLife | None) -> bool:
    """Return whether a run's folder shows that it has ended or has another hub since it was read."""
    if life is None:
        return False
    now = lives.read(life.folder)
    return now.ended or now.endpoint != life.endpoint


def _say_lost(options: argparse.Namespace, life: RunLife) -> int:
    if options.once and options.json:
        print(json.dumps(life.fields(), indent=1))
    say(life.loss(), error=True)
    return LOST


def _port(text: str) -> int:
    """Return the value of an option that is a port on this machine."""
    if not (text.isascii() and text.isdecimal()) or not 0 < int(text) < 2**16:
        raise argparse.ArgumentTypeError(f"value is {text!r}; allowed is a port from 1 to 65535, such as {WEB_PORT}")
    return int(text)


def _car(text: str) -> str:
    """Return the value of an option that names a car."""
    actor, _, car = text.partition("/")
    if not (actor.startswith("actor-") and actor[6:].isdecimal() and car.isascii() and car.isdecimal()):
        raise argparse.ArgumentTypeError(f"value is {text!r}; allowed is ACTOR/CAR, such as actor-0/0")
    return text


if __name__ == "__main__":
    cli.execute(main, make_parser())
