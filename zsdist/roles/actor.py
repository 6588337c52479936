"""Actor role: drives several cars by camera with local vision inference, and pushes their transitions."""

from collections.abc import Sequence
from typing import Protocol

from zsdist.agent.hierarchy import QFunctions, q_functions
from zsdist.common import random_streams
from zsdist.dqn import network
from zsdist.dqn.exploration import epsilon
from zsdist.driving.actor_car import ActorCar, EpisodeTask
from zsdist.driving.perception import Perception
from zsdist.errors import DecodeError, RunError, WeightsError
from zsdist.roles import schemas
from zsdist.roles.actor_outboxes import ActorOutboxes, CreditAccount
from zsdist.roles.base import HEARTBEAT_S, Context, Role
from zsdist.roles.car_views import CarViews
from zsdist.roles.drive_share import DriveShare
from zsdist.roles.schemas import ActorJobs, ActorOrders
from zsdist.roles.shapes import SHAPES
from zsdist.types import Level, Parameters
from zsdist.wire import keys
from zsdist.wire.messages import EPISODES, EVALUATION, Ack, Candidate, Jobs, Orders, WeightsMessage

MAX_CANDIDATES = 16  # pairs of networks kept; a merge has three


class SceneSource(Protocol):
    """Scenes by number: a pure function of the run's seed."""

    def training(self, number: int) -> object:
        """Return the scene of training episode `number`."""

    def validation(self, merge: int, index: int) -> object:
        """Return validation scene `index` of a merge."""


class Actor(Role):
    """Several cars in one process that share one vision model; pictures never leave the process."""

    def __init__(
        self, context: Context, cars: Sequence[ActorCar], perception: Perception, schedule: SceneSource
    ) -> None:
        super().__init__(context)
        self.cars = list(cars)
        self.perception = perception
        self.schedule = schedule
        self.env_steps = 0
        self.actions = 0  # of all cars, those of candidates included
        self.waiting_credit_s = 0.0
        self._cars_waiting = 0  # for credit
        self._waiting_since_s: float | None = None
        self._weights: dict[Level, WeightsMessage] = {}
        self._lags_s: dict[Level, float] = {}  # age at which the weights before the present ones were replaced
        self._max_lag_s = 0.0
        self._candidates: dict[tuple[int, str], dict[Level, Parameters]] = {}
        self._started: set[int] = set()  # numbers of the present leases that were begun; each is driven once
        self._started_episodes = 0
        self._jobs = ActorJobs(epoch=None, leases=[], finished=0, merge=0, drives=[])
        self._driven: set[tuple[int, str, int]] = set()
        self._share = DriveShare(context.config.merge.share, len(self.cars))
        self._run: ActorOrders | None = None  # progress of the run; it counts while this incarnation is named
        self._closing = False
        self._cut = False
        self._leaves = False
        self.is_named = False  # whether the newest jobs are for this incarnation
        self._outboxes = ActorOutboxes(context.run, context.name, context.epoch, context.config.transport)
        self._accounts = {car: CreditAccount() for car in self.cars}
        run = context.run
        self._acks = self.mailbox("ack")
        self._news = self.mailbox("weights")
        self._orders = self.mailbox("orders")
        self.transport.subscribe(keys.ack(run, context.name), self._acks)
        self.transport.subscribe(keys.weights(run, keys.ANY), self._news, retained=True)
        self.transport.subscribe(keys.candidate(run, keys.ANY, keys.ANY), self._news, retained=True)
        self.transport.subscribe(keys.control(run, "actor"), self._orders, retained=True)
        self.transport.subscribe(keys.evaluation(run, context.name), self._orders, retained=True)
        questions = self.mailbox("view")
        self.transport.serve(keys.view(run, context.name, keys.ANY), questions)
        self._views = CarViews(questions, context.name, context.config)

    def work(self, now: float) -> float:
        """Drive one action of every car that may act, and send what is due."""
        self._receive(now)
        self._cut_short()
        self._assign()
        driving = [car for car in self.cars if not car.idle]
        ready = [car for car in driving if self._may_act(car)]
        self._cars_waiting = len(driving) - len(ready)
        self._account_waiting(now, self._cars_waiting > 0)
        if ready:
            self._advance(ready)
        if self._closing and all(car.idle for car in self.cars):
            self.perception.close()
            self._outboxes.close()
        self._outboxes.flush(self.transport, now)
        self._views.answer(now, self.cars, self._online_q)
        self.finished = self._outboxes.drained
        return now if ready else min([now + HEARTBEAT_S, *self._outboxes.wakes(now)])

    def leave(self) -> None:
        """Cut all episodes, deliver what was driven, and finish, although the run goes on."""
        self._leaves = self._closing = self._cut = True

    def statistics(self) -> dict[str, float | str]:
        """Return counts of steps, cars and cached readings, versions and lags of weights, and counts of outboxes."""
        fields: dict[str, float | str] = {
            "env_steps": self.env_steps,
            "actions": self.actions,
            "cars": len(self.cars),
            "cars_driving": sum(not car.idle for car in self.cars),
            "cars_waiting_credit": self._cars_waiting,
            "waiting_credit_s": round(self.waiting_credit_s, 3),
            "started_episodes": self._started_episodes,
            **self.perception.statistics(),
        }
        fields |= {f"{level}_weight_version": message.weights.version for level, message in self._weights.items()}
        fields |= {f"{level}_weights_lag_s": round(lag_s, 4) for level, lag_s in self._lags_s.items()}
        fields["weights_max_lag_s"] = round(self._max_lag_s, 4)
        return fields | self._outboxes.statistics()

    def _receive(self, now: float) -> None:
        for _, ack in self.messages(self._acks, Ack):
            self._outboxes.on_ack(ack, now)
        for _, message in self.learner_news(self._news):
            if isinstance(message, WeightsMessage):
                self._take_weights(message, now)
            elif self._fits(message.level, message.parameters):
                self._take_candidate(message)
        for content in self.orders(self._orders, {Orders: ActorOrders, Jobs: ActorJobs}):
            if isinstance(content, ActorJobs):
                self._take_jobs(content)
            elif isinstance(content, ActorOrders):
                self._run = content
        if self.is_named and self._run is not None:
            self._follow(self._run)

    def _take_jobs(self, jobs: ActorJobs) -> None:
        self.is_named = jobs.epoch == self.context.epoch
        if self.is_named:  # else they are meant for a predecessor of this process, or for its successor
            if jobs.merge != self._jobs.merge:
                self._share.begin_merge()
            self._jobs = jobs
            self._started.intersection_update(jobs.leases)  # a number that is not leased to it any more never returns
            self._driven = {job for job in self._driven if job[0] >= jobs.merge}

    def _follow(self, run: ActorOrders) -> None:
        self._closing = run.closing or self._leaves
        self._cut = run.cut or self._leaves
        for key in [key for key in self._candidates if key[0] < run.merge]:
            del self._candidates[key]

    def _take_candidate(self, message: Candidate) -> None:
        key = (message.merge, message.name)
        if key in self._candidates or len(self._candidates) < MAX_CANDIDATES:
            self._candidates.setdefault(key, {})[message.level] = message.parameters
        else:
            self.refuse("candidates")

    def _fits(self, level: Level, parameters: Parameters, sha256: str | None = None) -> bool:
        """Return whether parameters fit a level's network and have the given hash; count a refusal if they do not."""
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
            # The time at which a missed version was made is unknown. It was made after the version that was held.
            follows = version == held.weights.version + 1 or message.sender_epoch != held.sender_epoch
            self._lags_s[level] = max(0.0, now - (message if follows else held).made_s)
            self._max_lag_s = max(self._max_lag_s, self._lags_s[level])

    def _assign(self) -> None:
        """Give idle cars their next task: drives of candidates within their share, and leases."""
        if self._closing or len(self._weights) < len(Level):
            return
        versions = {level: message.weights.version for level, message in self._weights.items()}
        for car in self.cars:
            if car.idle and (task := self._next_task()) is not None:
                car.begin(task, versions, self._candidate_q(task))

    def _next_task(self) -> EpisodeTask | None:
        number = next((number for number in self._jobs.leases if number not in self._started), None)
        driving = sum(not car.idle and not car.trains for car in self.cars)
        trains = number is not None or (self._run is not None and self._run.leasing)
        if (not trains or self._share.allows(driving)) and (task := self._next_drive()) is not None:
            return task
        return None if number is None else self._training(number)

    def _next_drive(self) -> EpisodeTask | None:
        merge = self._jobs.merge
        for candidate, index in self._jobs.drives:
            job = (merge, candidate, index)
            if job not in self._driven and len(self._candidates.get((merge, candidate), {})) == len(Level):
                self._driven.add(job)
                scene = self.schedule.validation(merge, index)
                seed = random_streams.candidate_drive(self.config.seed, merge, index)
                most_steps = self.config.merge.drive_steps
                return EpisodeTask(scene, index, 0.0, True, seed, candidate, merge, most_steps)
        return None

    def _training(self, number: int) -> EpisodeTask:
        """Begin the training episode with a number."""
        agent, seed = self.config.agent, self.config.seed
        self._started.add(number)
        self._started_episodes += 1
        share = epsilon(self._jobs.finished, agent.epsilon_decay, agent.epsilon_min)
        shielded = bool(random_streams.shielded_episodes(seed, number).random() < agent.shield_share)
        exploration = random_streams.exploration(seed, number)
        return EpisodeTask(self.schedule.training(number), number, share, shielded, exploration)

    def _may_act(self, car: ActorCar) -> bool:
        """Return whether a car may act: a step of a training episode needs credit for its transitions."""
        return not car.trains or car.over or self._outboxes.reserve(self._accounts[car])

    def _advance(self, cars: list[ActorCar]) -> None:
        for car, view in zip(cars, self.perception.views(cars), strict=True):
            ended = car.over
            car.advance(view, car.candidate_q or self._online_q())
            if not ended:
                self.actions += 1
                self._share.count(trains=car.trains)
            if car.trains:
                if not ended:
                    self.env_steps += 1
                    self._accounts[car].count_step()
                self._outboxes.offer(car.drain(), self._accounts[car])
            if ended:
                self._report(car)

    def _online_q(self) -> QFunctions:
        return q_functions({level: held.weights.parameters for level, held in self._weights.items()})

    def _candidate_q(self, task: EpisodeTask) -> QFunctions | None:
        if task.trains:
            return None
        return q_functions(self._candidates[task.merge, task.candidate])

    def _report(self, car: ActorCar) -> None:
        stream = EPISODES if car.trains else EVALUATION
        record = car.record() | {"actor": self.context.name}
        try:
            schemas.check_record(stream, record)
        except DecodeError as error:
            raise RunError(f"{self.context.name}: the record of an episode is out of range: {error}") from error
        self._outboxes.release(self._accounts[car])
        self._outboxes.offer_record(stream, record)

    def _cut_short(self) -> None:
        """Abort drives of dropped candidates, and at a stop all episodes."""
        for car in self.cars:
            if not car.idle and (self._cut or self._unwanted(car.task)):
                self._outboxes.offer(car.cut(), self._accounts[car])
                self._outboxes.release(self._accounts[car])

    def _unwanted(self, task: EpisodeTask) -> bool:
        if task.trains:
            return False
        return task.merge != self._jobs.merge or (task.candidate, task.number) not in self._jobs.drives

    def _account_waiting(self, now: float, waiting: bool) -> None:
        if self._waiting_since_s is not None:
            self.waiting_credit_s += now - self._waiting_since_s
        self._waiting_since_s = now if waiting else None
