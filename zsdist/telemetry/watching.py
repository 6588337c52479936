"""Watching of a run from outside: the only run at a hub, and a snapshot of all roles."""

import time
from collections.abc import Callable
from enum import Enum, auto
from typing import Any

from zsdist.errors import RunError
from zsdist.telemetry.display import MAILBOX_BYTES, Display
from zsdist.telemetry.snapshot import Snapshot
from zsdist.transport.base import Mailbox, Transport
from zsdist.wire import keys

FIRST_REPORT_WITHIN_S = 5.0  # every role reports once a second
GONE_AFTER_S = 30.0  # silence after which a run is gone; a hub that died is replaced within seconds
LOOK_EVERY_S = 1.0


class Sight(Enum):
    """Reason for which watching stopped."""

    ONCE = auto()  # one snapshot was asked for
    ENDED = auto()  # the run said that it is done
    MOVED = auto()  # its folder says that it has ended, or that its hub is elsewhere
    GONE = auto()  # it has been silent for too long


def only_run(transport: Transport, endpoint: str) -> str:
    """Return the name of the run at a hub.

    Args:
        transport: connected to the hub.
        endpoint: endpoint of the hub, for the error.

    Raises:
        RunError: the hub carries no run, or several.
    """
    mailbox, names = Mailbox(MAILBOX_BYTES), set[str]()
    transport.watch_alive(keys.alive(keys.ANY, keys.ANY, keys.ANY), mailbox)
    deadline_s = time.monotonic() + FIRST_REPORT_WITHIN_S
    while not names and time.monotonic() < deadline_s:
        time.sleep(0.2)
        names = {parsed.run for message in mailbox.drain() if (parsed := keys.parse(message.key)) is not None}
    if len(names) != 1:
        found = ", ".join(sorted(names)) or "none"
        raise RunError(f"--run is needed where a hub does not carry exactly one run; runs at {endpoint}: {found}")
    return names.pop()


def wait_for_reports(display: Display, transport: Transport) -> Snapshot:
    """Receive statistics until every living role has reported, or until time is up; return the snapshot.

    Raises:
        RunError: no role reported.
    """
    snapshot, deadline_s = display.snapshot, time.monotonic() + FIRST_REPORT_WITHIN_S
    while time.monotonic() < deadline_s:
        display.update(transport)
        if snapshot.alive and snapshot.alive <= set(snapshot.roles):
            break
        time.sleep(0.05)
    if not snapshot.roles:
        raise RunError(f"no role of run {display.run!r} reported within {FIRST_REPORT_WITHIN_S:g} s")
    return snapshot


def follow(display: Display, transport: Transport, moved: Callable[[], bool]) -> Sight:
    """Show a run until it is out of sight; return the reason.

    Args:
        display: display of the run.
        transport: connected to its hub.
        moved: tells whether the run has ended or has another hub, by what its folder shows; asked while it is silent.
    """
    next_look_s = 0.0
    while True:
        display.refresh(transport, time.time())
        if display.done:
            return Sight.ENDED
        if display.is_quiet and time.monotonic() >= next_look_s:
            next_look_s = time.monotonic() + LOOK_EVERY_S
            if moved():
                return Sight.MOVED
        if display.silent_s > GONE_AFTER_S:
            return Sight.GONE
        time.sleep(0.1)


def snapshot_fields(run: str, snapshot: Snapshot) -> dict[str, Any]:
    """Return a snapshot as the fields of `zsdist.monitor --once --json`."""
    return {
        "run": run,
        "alive": sorted("/".join(role) for role in snapshot.alive),
        "figures": snapshot.row(),
        "roles": {"/".join(role): fields for role, fields in sorted(snapshot.roles.items())},
    }
