"""Watching of a run from outside: the only run at a hub, and a snapshot of all roles."""

import time
from typing import Any

from zsdist.errors import RunError
from zsdist.telemetry.display import MAILBOX_BYTES, Display
from zsdist.telemetry.snapshot import Snapshot
from zsdist.transport.base import Mailbox, Transport
from zsdist.wire import keys

FIRST_REPORT_WITHIN_S = 5.0  # every role reports once a second


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


def snapshot_fields(run: str, snapshot: Snapshot) -> dict[str, Any]:
    """Return a snapshot as the fields of `zsdist.monitor --once --json`."""
    return {
        "run": run,
        "alive": sorted("/".join(role) for role in snapshot.alive),
        "figures": snapshot.row(),
        "roles": {"/".join(role): fields for role, fields in sorted(snapshot.roles.items())},
    }
