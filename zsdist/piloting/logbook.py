"""Recording of a drive as MCAP: what is heard, what is commanded, and the believed map at each decision."""

import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from zsdist.common import output_files
from zsdist.planning.belief import BeliefMap
from zsdist.recording import messages
from zsdist.recording.log import Log


class Logbook:
    """MCAP file of one drive. Each message is in the file when the call that writes it returns.

    A write that fails raises `RunError`, once: what is written later is left out, so that it hinders no last command.

    Args:
        path: file to write; an older one is overwritten.
        topics: topic and type by the name under which messages are heard or sent.
    """

    def __init__(self, path: Path, topics: Mapping[str, tuple[str, str]]) -> None:
        self._path, self._log = path, Log(path)
        self._broken = False
        self._topics = topics
        self._lock = threading.Lock()

    def __enter__(self) -> "Logbook":
        return self

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._log.close()

    def write(self, name: str, data: bytes) -> None:
        """Write a message as it came or goes, CDR with its header."""
        topic, kind = self._topics[name]
        self._write(lambda: self._log.write_encoded(topic, kind, data, time.time_ns()))

    def write_map(self, belief: BeliefMap, centre: tuple[float, float]) -> None:
        """Write a believed map, whose arena has its centre at a point of the odometry's frame."""
        now_ns = time.time_ns()
        message = messages.occupancy_grid(belief.grid, belief.occupied(), belief.seen(), now_ns)
        message.info.origin.position.x += centre[0]
        message.info.origin.position.y += centre[1]
        self._write(lambda: self._log.write(messages.BELIEF, message, now_ns))

    def _write(self, write: Callable[[], None]) -> None:
        with self._lock:
            if self._broken:
                return
            self._broken = True  # until the write has succeeded
            with output_files.written(f"--record {self._path}"):
                write()
            self._broken = False
