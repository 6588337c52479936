"""The actor role: drives several cars by camera with local visual-act inference, and pushes what they lived through."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from zsdist.agent.hierarchy import QFunctions, q_functions
from zsdist.dqn import network
from zsdist.dqn.exploration import epsilon
from zsdist.driving.episode import Car, EpisodeTask
from zsdist.driving.perception import Perception
from zsdist.errors import RunError, WeightsError
from zsdist.protocol.outbox import Outbox
from zsdist.roles.base import HEARTBEAT_S, Context, Role
from zsdist.roles.schemas import ActorOrders, DriveJobs
from zsdist.roles.shapes import SHAPES
from zsdist.types import Level, Parameters
from zsdist.wire import codec, keys
from zsdist.wire.messages import EPISODES, EVALUATION, Ack, Candidate, Jobs, Orders, Push, Records, WeightsMessage

MAX_CANDIDATES = 16  # pairs kept; a merge has three


class SceneSource(Protocol):
    """Which scene belongs to which number: a pure function of the run's seed."""

    def training(self, number: int) -> object:
        """Scene of training episode `number`."""

    def validation(self, merge: int, index: int) -> object:
        """Validation scene `index` of a merge."""


class Actor(Role):
    """Several cars in one process with batched inference; pictures never leave it."""

    def __init__(self, context: Context, cars: Sequence[Car], perception: Perception, schedule: SceneSource) -> None:
        super().__init__(context)
        self.cars = list(cars)
        self.perception = perception
        self.schedule = schedule
        self.env_steps = 0
        self.waiting_credit_s = 0.0
        self._waiting_since_s: float | None = None
        self._weights: dict[Level, WeightsMessage] = {}
        self._lags_s: dict[Level, float] = {}  # how long the weights before the present ones were out of date
        self._max_lag_s = 0.0
        self._candidates: dict[tuple[int, str], dict[Level, Parameters]] = {}
        self._leases: list[int] = []
        self._started: set[int] = set()  # leases taken up; a number is driven once by this process
        self._jobs = DriveJobs(merge=0, drives=[])
        self._driven: set[tuple[int, str, int]] = set()
        self._finished_episodes = 0
        self._closing = False
        self._cut = False
        settings = context.config.transport
        self._outboxes = {
            stream: Outbox(
                stream,
                context.name,
                context.epoch,
                window_frames=settings.window_frames,
                resend_after_s=settings.resend_after_s,
                give_up_after_s=settings.give_up_after_s,
                make_frame=Push if stream in (Level.HIGH, Level.LOW) else Records,
            )
            for stream in (Level.HIGH, Level.LOW, EPISODES, EVALUATION)
        }
        run = context.run
        self._acks = self.mailbox("ack")
        self._news = self.mailbox("weights")
        self._orders = self.mailbox("orders")
        self.transport.subscribe(keys.ack(run, context.name), self._acks)
        self.transport.subscribe(keys.weights(run, keys.ANY), self._news, retained=True)
        self.transport.subscribe(keys.candidate(run, keys.ANY, keys.ANY), self._news, retained=True)
        self.transport.subscribe(keys.control(run, "actor"), self._orders, retained=True)
        self.transport.subscribe(keys.evaluation(run, context.name), self._orders, retained=True)

    def work(self, now: float) -> float:
        """One action of every car that may act, and whatever has to be sent."""
        self._receive(now)
        self._cut_short()
        self._assign()
        driving = [car for car in self.cars if car.task]
        ready = [car for car in driving if self._reserve(car)]
        self._account_waiting(now, len(ready) < len(driving))
        if ready:
            self._advance(ready)
        if self._closing and not any(car.task for car in self.cars):
            self.perception.close()
            for outbox in self._outboxes.values():
                outbox.close()
        self._flush(now)
        self.finished = all(outbox.drained for outbox in self._outboxes.values())
        if ready:
            return now
        return min([now + HEARTBEAT_S, *(wake for box in self._outboxes.values() if (wake := box.next_wake(now)))])

    def statistics(self) -> dict[str, float | str]:
        """Steps driven, cars, readings remembered or not, versions acted with, and what waits in the outboxes."""
        fields: dict[str, float | str] = {
            "env_steps": self.env_steps,
            "cars": len(self.cars),
            "cars_driving": sum(1 for car in self.cars if car.task),
            "waiting_credit_s": round(self.waiting_credit_s, 3),
            "started_episodes": len(self._started),
            **self.perception.statistics(),
        }
        fields |= {f"{level}_weight_version": message.weights.version for level, message in self._weights.items()}
        fields |= {f"{level}_weights_lag_s": round(lag_s, 4) for level, lag_s in self._lags_s.items()}
        fields["weights_max_lag_s"] = round(self._max_lag_s, 4)
        for stream, outbox in self._outboxes.items():
            fields |= {f"{stream}_{name}": value for name, value in outbox.statistics().items()}
        return fields

    def _receive(self, now: float) -> None:
        for _, ack in self.messages(self._acks, Ack):
            self._outboxes[ack.stream].on_ack(ack, now)
        for _, message in self.messages(self._news, WeightsMessage, Candidate):
            if isinstance(message, WeightsMessage):
                self._take_weights(message, now)
            elif self._fits(message.level, message.parameters):
                self._take_candidate(message)
        for content in self.orders(self._orders, {Orders: ActorOrders, Jobs: DriveJobs}):
            if isinstance(content, DriveJobs):
                self._jobs = content
            else:
                self._follow(content)

    def _follow(self, content: ActorOrders) -> None:
        if content.epochs.get(self.context.name) != self.context.epoch:
            return  # said to a predecessor of this process, or to its successor
        self._leases = content.leases.get(self.context.name, [])
        self._finished_episodes = content.finished
        self._closing = content.closing
        self._cut = content.cut
        for key in [key for key in self._candidates if key[0] < content.merge]:
            del self._candidates[key]

    def _take_candidate(self, message: Candidate) -> None:
        key = (message.merge, message.name)
        if key in self._candidates or len(self._candidates) < MAX_CANDIDATES:
            self._candidates.setdefault(key, {})[message.level] = message.parameters
        else:
            self.refuse("candidates")

    def _fits(self, level: Level, parameters: Parameters, sha256: str | None = None) -> bool:
        """Whether these are weights of a level's network, and those that the hash is of; counted where not."""
        shape = SHAPES[level]
        try:
            network.check(parameters, shape.state_size, shape.actions)
        except WeightsError:
            self.refuse("weights")
            return False
        if sha256 is not None and network.sha256(parameters) != sha256:
            self.refuse("hash")
            return False
        return True

    def _take_weights(self, message: WeightsMessage, now: float) -> None:
        level, version = message.weights.level, message.weights.version
        held = self._weights.get(level)
        if held is not None and (message.sender_epoch, version) <= (held.sender_epoch, held.weights.version):
            return
        if not self._fits(level, message.weights.parameters, message.sha256):
            return
        self._weights[level] = message
        if held is not None:
            # Where a version was missed nobody knows when it came to be: at the earliest with the one that was held.
            follows = version == held.weights.version + 1 or message.sender_epoch != held.sender_epoch
            self._lags_s[level] = max(0.0, now - (message if follows else held).made_s)
            self._max_lag_s = max(self._max_lag_s, self._lags_s[level])

    def _assign(self) -> None:
        """Gives idle cars their next errand: evaluation drives first, then leases."""
        if self._closing or len(self._weights) < len(Level):
            return
        versions = {level: message.weights.version for level, message in self._weights.items()}
        for car in self.cars:
            if car.task is None and (task := self._next_errand()) is not None:
                car.begin(task, versions, self._candidate_q(task))

    def _next_errand(self) -> EpisodeTask | None:
        merge, agent = self._jobs.merge, self.config.agent
        for candidate, index in self._jobs.drives:
            job = (merge, candidate, index)
            if job not in self._driven and len(self._candidates.get((merge, candidate), {})) == len(Level):
                self._driven.add(job)
                scene = self.schedule.validation(merge, index)
                most = self.config.merge.drive_steps
                return EpisodeTask(scene, index, 0.0, True, (self.config.seed, merge, index), candidate, merge, most)
        for number in self._leases:
            if number not in self._started:
                self._started.add(number)
                share = epsilon(self._finished_episodes, agent.epsilon_decay, agent.epsilon_min)
                seed = (self.config.seed, number)
                shielded = bool(np.random.default_rng([*seed, 1]).random() < agent.shield_share)
                return EpisodeTask(self.schedule.training(number), number, share, shielded, seed)
        return None

    def _reserve(self, car: Car) -> bool:
        """Takes credit for one more transition of each level before it is lived, so that flushing never has to wait.

        The replay grants a stream at least one whole option a car ahead of what it holds, so every option can end.
        """
        if not car.task.trains or car.over:
            return True
        for level, outbox in self._metered():
            missing = car.unoffered[level] + 1 - car.credit[level]
            if missing > 0:
                if not outbox.reserve(missing):
                    return False
                car.credit[level] += missing
        return True

    def _advance(self, cars: list[Car]) -> None:
        for car, view in zip(cars, self.perception.views(cars), strict=True):
            ended = car.over
            car.advance(view, car.candidate_q or self._online_q())
            if car.task.trains:
                self.env_steps += not ended
                for level in Level:
                    car.unoffered[level] += not ended
                self._collect(car)
            if ended:
                self._report(car)

    def _online_q(self) -> QFunctions:
        return q_functions({level: held.weights.parameters for level, held in self._weights.items()})

    def _candidate_q(self, task: EpisodeTask) -> QFunctions | None:
        if task.trains:
            return None
        return q_functions(self._candidates[task.merge, task.candidate])

    def _collect(self, car: Car) -> None:
        for trajectory in car.agent.drain():
            self._outboxes[trajectory.level].offer([trajectory])
            car.credit[trajectory.level] -= len(trajectory)
            car.unoffered[trajectory.level] -= len(trajectory)

    def _report(self, car: Car) -> None:
        trains = car.task.trains
        record = car.record() | {"actor": self.context.name}
        self._release(car)
        self._outboxes[EPISODES if trains else EVALUATION].offer([record])

    def _release(self, car: Car) -> None:
        for level, outbox in self._metered():
            outbox.release(car.credit[level])
            car.credit[level] = 0

    def _cut_short(self) -> None:
        """Ends what nobody waits for any more: drives of a candidate that was dropped, and everything at a stop."""
        for car in self.cars:
            if car.task is None or not (self._cut or self._unwanted(car.task)):
                continue
            trains = car.task.trains
            car.cut()
            if trains:
                self._collect(car)
            self._release(car)

    def _unwanted(self, task: EpisodeTask) -> bool:
        if task.trains:
            return False
        return task.merge != self._jobs.merge or (task.candidate, task.number) not in self._jobs.drives

    def _metered(self) -> list[tuple[Level, Outbox]]:
        return [(level, self._outboxes[level]) for level in Level]

    def _flush(self, now: float) -> None:
        name = self.context.name
        for stream, outbox in self._outboxes.items():
            if outbox.stuck(now):
                raise RunError(
                    f"{name}: the oldest frame of stream {stream!r} has gone unacknowledged for "
                    f"{self.config.transport.give_up_after_s:g} s while its receiver lives"
                )
            for frame in outbox.poll(now):
                self.transport.publish(self._key_of(stream), codec.encode(frame))

    def _key_of(self, stream: Level | str) -> str:
        run, name, epoch = self.context.run, self.context.name, self.context.epoch
        if stream == EVALUATION:
            return keys.evaluation(run, name)
        return keys.episodes(run, name, epoch) if stream == EPISODES else keys.push(run, stream, name, epoch)

    def _account_waiting(self, now: float, waiting: bool) -> None:
        if self._waiting_since_s is not None:
            self.waiting_credit_s += now - self._waiting_since_s
        self._waiting_since_s = now if waiting else None
