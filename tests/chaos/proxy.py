"""TCP proxy before the hub, which cuts, freezes, delays and throttles what passes it."""

import asyncio
import contextlib
import threading
import time
from collections.abc import Callable

CHUNK = 16 * 1024
TICK_S = 0.01


class Proxy:
    """Proxy on a port of this machine; it works from the beginning and changes nothing until it is told to.

    Args:
        port: port to listen at.
        target: function that returns the port of the hub.

    Attributes:
        frozen: whether nothing passes, while connections stay open.
        delay_s: time that each byte takes.
        bytes_per_s: most bytes a second in each direction, all connections together; None: no limit.
        passed: number of bytes that have passed.
    """

    def __init__(self, port: int, target: Callable[[], int]) -> None:
        self.frozen, self.delay_s, self.bytes_per_s = False, 0.0, None
        self.passed = 0
        self._port, self._target = port, target
        self._cut = False
        self._free_s = [0.0, 0.0]  # time at which each direction is free again
        self._writers: set[asyncio.StreamWriter] = set()
        self._loop = asyncio.new_event_loop()
        self._ready = threading.Event()
        threading.Thread(target=self._run, daemon=True).start()
        assert self._ready.wait(5.0), f"port {port} cannot be used"

    def cut(self) -> None:
        """Close all connections, and accept none until `mend`."""
        self._cut = True
        self._loop.call_soon_threadsafe(self._drop)

    def mend(self) -> None:
        """Let everything pass again."""
        self._cut, self.frozen, self.delay_s, self.bytes_per_s = False, False, 0.0, None

    def close(self) -> None:
        """Close all connections and the port."""
        self._loop.call_soon_threadsafe(self._loop.stop)

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        server = self._loop.run_until_complete(asyncio.start_server(self._accept, "127.0.0.1", self._port))
        self._ready.set()
        self._loop.run_forever()
        self._drop()
        server.close()

    def _drop(self) -> None:
        for writer in self._writers:
            writer.transport.abort()

    async def _accept(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self._cut:
            writer.transport.abort()
            return
        try:
            far_reader, far_writer = await asyncio.open_connection("127.0.0.1", self._target())
        except OSError:  # no hub listens there at present
            writer.transport.abort()
            return
        pair = {writer, far_writer}
        self._writers |= pair
        with contextlib.suppress(OSError):
            await asyncio.gather(self._pump(reader, far_writer, 0), self._pump(far_reader, writer, 1))
        for end in pair:
            end.transport.abort()
        self._writers -= pair

    async def _pump(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, direction: int) -> None:
        """Pass everything from one connection to the other, each byte when it is due."""
        queue: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue(64)
        sender = asyncio.ensure_future(self._send(queue, writer))
        try:
            while data := await reader.read(CHUNK):
                await queue.put((self._due_s(len(data), direction), data))
        finally:
            await queue.put((0.0, b""))
            await sender
            if not writer.is_closing():
                writer.transport.abort()

    async def _send(self, queue: asyncio.Queue, writer: asyncio.StreamWriter) -> None:
        while True:
            due_s, data = await queue.get()
            if not data:
                return
            while self.frozen or time.monotonic() < due_s:
                await asyncio.sleep(TICK_S if self.frozen else max(0.0, due_s - time.monotonic()))
            if writer.is_closing():
                continue
            writer.write(data)
            self.passed += len(data)
            with contextlib.suppress(OSError):
                await writer.drain()

    def _due_s(self, count: int, direction: int) -> float:
        now = time.monotonic()
        if self.bytes_per_s is None:
            return now + self.delay_s
        self._free_s[direction] = max(self._free_s[direction], now) + count / self.bytes_per_s
        return self._free_s[direction] + self.delay_s
