"""Answers of an actor to watchers who ask for its cars: each at most twice a second, and no work while nobody asks."""

import json
from collections.abc import Callable, Sequence

from zsdist.agent.hierarchy import QFunctions
from zsdist.config import Config
from zsdist.driving import car_view
from zsdist.driving.actor_car import ActorCar
from zsdist.transport.base import Mailbox
from zsdist.types import Level
from zsdist.wire import keys

ALL = "all"  # in place of a car: where all of them are
EVERY_S = 0.5  # a question that comes earlier gets the same answer again


class CarViews:
    """Answers about the cars of one actor, as JSON.

    Args:
        mailbox: mailbox of the questions, under `keys.view`.
        actor: name of the actor.
        config: configuration of the run.
    """

    def __init__(self, mailbox: Mailbox, actor: str, config: Config) -> None:
        self._mailbox, self._actor, self._config = mailbox, actor, config
        self._answers: dict[str, tuple[float, bytes]] = {}  # newest by car, with its time

    def answer(self, now: float, cars: Sequence[ActorCar], online_q: Callable[[], QFunctions]) -> None:
        """Answer all questions; one about a car that is not there gets no answer.

        Args:
            now: unix time.
            cars: cars of the actor.
            online_q: returns the newest networks, which drive cars in training.
        """
        if not len(self._mailbox):
            return
        for message in self._mailbox.drain():
            parsed = keys.parse(message.key)
            if message.reply is None or parsed is None or parsed.kind != "view":
                continue
            answer = self._answer(parsed.fields["car"], now, cars, online_q)
            if answer is not None:
                message.reply(answer)

    def _answer(
        self, name: str, now: float, cars: Sequence[ActorCar], online_q: Callable[[], QFunctions]
    ) -> bytes | None:
        made_s, answer = self._answers.get(name, (0.0, b""))
        if answer and made_s <= now < made_s + EVERY_S:
            return answer
        about = {"time_s": round(now, 3), "actor": self._actor}
        if name == ALL:
            fields = about | {"cars": [{"car": index, **car_view.overview(car)} for index, car in enumerate(cars)]}
        else:
            index = next((index for index in range(len(cars)) if name == str(index)), None)
            if index is None:
                return None
            car = cars[index]
            driven_by = None if car.idle else (car.candidate_q or online_q())[Level.HIGH]
            fields = about | {"car": index, **car_view.detail(car, self._config, driven_by)}
        answer = json.dumps(fields, allow_nan=False, separators=(",", ":")).encode()
        self._answers[name] = now, answer
        return answer
