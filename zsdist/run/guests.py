"""Actors that join a run from elsewhere, as the run's runner admits and dismisses them."""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

from zsdist import __version__
from zsdist.errors import DecodeError
from zsdist.roles import permissions, schemas
from zsdist.roles.schemas import JoinRequest, JoinTerms, JoinVerdict
from zsdist.run.program import RunSpec
from zsdist.transport.base import Mailbox, Message, Transport
from zsdist.wire import addresses, codec, keys
from zsdist.wire.messages import Admission

LOST_AFTER_S = 5.0  # time without its liveliness token after which a guest is gone; it may reconnect until then
MAILBOX_BYTES, TOKENS_BYTES = 256 * 1024, 4 * 2**20
MOST_ANSWERS = 64  # in one step; other requests wait
SCHEDULER = "scheduler-0"  # present whenever the hub is


@dataclass
class _Guest:
    """Actor that has joined.

    Attributes:
        joiner: word of the command that started its process.
        process: word of its process.
        seen_s: time at which it was last known to be there.
    """

    joiner: str
    process: str
    seen_s: float


class Guests:
    """Actors that have joined a run from elsewhere, and the answers to those that want to.

    Each gets an epoch from the run directory, and the runner's orders to the scheduler name it. It is gone once it says
    so, or when its liveliness token has been away for `LOST_AFTER_S`. Its name may then be taken again. Time in which
    the hub is away does not count, since nobody's token can be seen then.

    Args:
        spec: specification of the run.
        transport: transport of the runner.
        issue_epoch: function that returns a new epoch.

    Attributes:
        epochs: epoch of each guest.
        left: last epoch of each name whose guest is gone.
    """

    def __init__(self, spec: RunSpec, transport: Transport, issue_epoch: Callable[[], int]) -> None:
        self.epochs: dict[str, int] = {}
        self.left: dict[str, int] = {}
        self._spec, self._issue_epoch = spec, issue_epoch
        self._own = [permissions.actor_name(number) for number in range(spec.config.run.actors)]
        self._guests: dict[str, _Guest] = {}
        self._alive: set[str] = set()
        self._waiting: deque[Message] = deque()
        self._requests, self._tokens = Mailbox(MAILBOX_BYTES), Mailbox(TOKENS_BYTES)
        transport.serve(keys.join(spec.run, keys.ANY), self._requests)
        transport.watch_alive(keys.alive(spec.run, keys.ANY, keys.ANY), self._tokens)

    def step(self, now: float) -> None:
        """Notice who is gone, and answer requests.

        Args:
            now: current time, seconds.
        """
        self._notice(now)
        if len(self._waiting) < MOST_ANSWERS:
            self._waiting.extend(self._requests.drain())
        for _ in range(min(MOST_ANSWERS, len(self._waiting))):
            self._answer(self._waiting.popleft(), now)

    def _notice(self, now: float) -> None:
        for message in self._tokens.drain():
            parsed = keys.parse(message.key)
            if parsed is not None:
                name = f"{parsed.fields['role']}-{parsed.fields['id']}"
                (self._alive.add if message.payload == b"1" else self._alive.discard)(name)
        for name, guest in list(self._guests.items()):
            if name in self._alive or SCHEDULER not in self._alive:
                guest.seen_s = now
            elif now - guest.seen_s >= LOST_AFTER_S:
                self._dismiss(name)

    def _dismiss(self, name: str) -> None:
        del self._guests[name]
        self.left[name] = self.epochs.pop(name)

    def _answer(self, message: Message, now: float) -> None:
        if message.reply is None:
            return
        parsed = keys.parse(message.key)
        if parsed is None or not permissions.is_actor_name(name := parsed.fields["actor"]):
            return  # under a pattern or a name without rights; nobody else can read an answer
        answer: JoinTerms | JoinVerdict
        try:
            admission = codec.decode(message.payload, expect=Admission)
            addresses.require(message.key, self._spec.run, admission)
            request = schemas.read(JoinRequest, admission.content)
        except DecodeError as error:
            answer = self._verdict(None, f"the request is not understood: {error}"[:200])
        else:
            answer = self._terms() if request.ask == "terms" else self._decide(name, request, now)
        message.reply(codec.encode(Admission(name, answer.model_dump())))

    def _terms(self) -> JoinTerms:
        spec = self._spec
        return JoinTerms(
            run=spec.run,
            start=spec.start,
            version=__version__,
            settings=spec.config.model_dump(mode="json", exclude={"transport": {"tls", "endpoint"}}),
            vision=spec.vision.to_json(),
            taken=[*self._own, *self._guests],
        )

    def _decide(self, name: str, request: JoinRequest, now: float) -> JoinVerdict:
        """Admit an actor or let it go; the same request again gets the same answer."""
        guest = self._guests.get(name)
        if request.ask == "leave":
            if guest is not None and guest.process == request.process:
                self._dismiss(name)
            return self._verdict(None, "it has left")
        if guest is not None and guest.process == request.process:
            return self._verdict(self.epochs[name])
        if name in self._own or (guest is not None and guest.joiner != request.joiner):
            return self._verdict(None, f"{name} takes part already")
        self.epochs[name] = self._issue_epoch()
        self.left.pop(name, None)
        self._guests[name] = _Guest(request.joiner, request.process, now)
        return self._verdict(self.epochs[name])

    def _verdict(self, epoch: int | None, reason: str = "") -> JoinVerdict:
        return JoinVerdict(start=self._spec.start, epoch=epoch, reason=reason)
