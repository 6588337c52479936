"""A made-up run with many cars, as watchers see it: roles that report, and actors that answer about their cars.

Its cars drive in circles. `python tests/made_cars.py ENDPOINT CARS` plays it at a hub of its own until it is ended.
"""

import base64
import io
import json
import math
import sys
import threading
import time

import numpy as np
from PIL import Image

from zsdist.transport.base import Mailbox, Transport
from zsdist.transport.zenoh import ZenohHub, ZenohTransport
from zsdist.wire import keys

RUN = "demo"
CARS_PER_ACTOR = 4
EVERY_S = 0.5
FIELDS = 45  # of an actor's statistics, as many as real ones have


class MadeUpRun:
    """Roles and cars of a run; `step` sends and answers what is due.

    Attributes:
        asked: number of questions about cars so far.
    """

    def __init__(self, transport: Transport, cars: int) -> None:
        self.transport, self.actors, self.asked = transport, max(1, cars // CARS_PER_ACTOR), 0
        self.questions = Mailbox(2**24)
        self._begin_s = time.time()
        self._next_s = 0.0
        self._picture = _picture()
        for role, identifier in self.roles():
            transport.declare_alive(keys.alive(RUN, role, identifier))
        transport.serve(keys.view(RUN, keys.ANY, keys.ANY), self.questions)

    def roles(self) -> list[tuple[str, str]]:
        """Return all roles."""
        fixed = [("scheduler", "0"), ("replay", "0"), ("learner", "high"), ("learner", "low"), ("hub", "0")]
        return fixed + [("actor", str(index)) for index in range(self.actors)]

    def step(self) -> None:
        """Report twice a second, and answer all questions."""
        now = time.time()
        if now >= self._next_s:
            self._next_s = now + EVERY_S
            for role, identifier in self.roles():
                self._report(role, identifier, now)
        for message in self.questions.drain():
            self.asked += 1
            actor, car = message.key.split("/")[-2:]
            message.reply(json.dumps(self._answer(actor, car, now)).encode())

    def event(self, event: str, **fields: float | str) -> None:
        """Publish an event."""
        about = {"time_s": time.time(), "role": "scheduler", "id": "0", "host": "pc-7", "pid": 1, "event": event}
        self.transport.publish(keys.events(RUN), json.dumps(about | fields).encode(), json=True)

    def _report(self, role: str, identifier: str, now: float) -> None:
        run_s = now - self._begin_s
        fields = {"time_s": round(now, 3), "role": role, "id": identifier, "host": "pc-7", "pid": 7, "epoch": 1}
        match role:
            case "scheduler":
                share = 1 - math.exp(-run_s / 60)
                fields |= {"stage": "train", "episodes": int(run_s), "episodes_target": 4000, "recent_success": share}
                fields |= {"mean_return": 400 * share, "epsilon": 1 - share, "success": 7, "collision": 2, "timeout": 1}
            case "learner":
                fields |= {"learner_updates": int(50 * run_s), "loss": 0.02 + 0.1 * math.exp(-run_s / 40)}
                fields |= {"weight_version": int(run_s), "q_mean": 0.4, "waiting_data_s": 0.1}
            case "replay":
                fields |= {"low_size": int(20 * run_s), "high_size": int(6 * run_s), "low_stored": 1, "low_sampled": 4}
            case "actor":
                fields |= {"env_steps": int(8 * run_s), "cars": CARS_PER_ACTOR, "cars_driving": CARS_PER_ACTOR}
                fields |= {f"figure_{index}": index * run_s for index in range(FIELDS)}
        self.transport.publish(keys.stats(RUN, role, identifier), json.dumps(fields).encode(), json=True)

    def _answer(self, actor: str, car: str, now: float) -> dict:
        about = {"time_s": now, "actor": actor}
        first = CARS_PER_ACTOR * int(actor.removeprefix("actor-"))
        if car == "all":
            return about | {"cars": [{"car": n} | overview(first + n, now) for n in range(CARS_PER_ACTOR)]}
        return about | {"car": int(car)} | overview(first + int(car), now) | self._detail(first + int(car), now)

    def _detail(self, number: int, now: float) -> dict:
        rays = np.degrees(np.arctan(1 - 2 * (np.arange(32) + 0.5) / 32))
        median = 2.5 + 2 * np.sin(np.arange(32) / 4 + now)
        y, x = np.mgrid[:160, :160]
        seen, occupied = (x - 80) ** 2 + (y - 80) ** 2 < 3000, (x - 80) ** 2 + (y - 80) ** 2 > 2600
        place, block = pose(number, now), [2, 1]
        return {
            "arena_m": 25.0, "grid_m": 20.0, "blocks": 4, "epsilon": 0.4, "shielded": True, "decided_at": place,
            "path": [pose(number, now - 0.3 * back)[:2] for back in range(60, -1, -1)],
            "picture": self._picture,
            "camera": {"field_of_view_deg": 90.0, "height_m": 1.0, "forward_m": 1.0, "range_m": 5.0},
            "rays": {
                "angles_deg": rays.round(1).tolist(), "near_m": (0.8 * median).round(2).tolist(),
                "median_m": median.round(2).tolist(), "far_m": (1.15 * median).clip(0, 5).round(2).tolist(),
            },
            "clearance_m": [3.0, 2.0, 4.5], "dynamic": [0.1, 0.0, 0.3], "advice": [0.9, 0.2, -0.3],
            "belief": {"size": 160, "seen": _bits(seen), "occupied": _bits(seen & occupied)},
            "action": "left_45", "behaviour": "greedy", "shield_changed": False, "subgoal": [3.0, 1.0],
            "choices": [{"block": block, "value": 0.7, "goal": False}, {"block": [1, 2], "value": 0.4, "goal": False},
                        {"block": [3, 3], "value": 0.5, "goal": True}],
            "gradients": [{"block": [bx, by], "to": [0.6, 0.8], "way_m": 9.0} for bx in range(4) for by in range(4)],
            "way": [place[:2], [3.0, 1.0], [8.0, 8.0]],
        }  # fmt: skip


def pose(number: int, now: float) -> list[float]:
    """Return the pose of a car on its circle."""
    angle, radius = now / 8 + number, 3 + number % 5
    x, y = radius * math.cos(angle), radius * math.sin(angle)
    return [round(x, 2), round(y, 2), round(math.degrees(angle) + 90, 1)]


def overview(number: int, now: float) -> dict:
    """Return where a car is."""
    circles = [[round(11 * math.cos(n + number), 1), round(11 * math.sin(n + number), 1), 1.0] for n in range(12)]
    return {
        "kind": "training", "number": number, "step": int(now) % 100, "scene": f"iid-{number}", "outcome": "",
        "pose": pose(number, now), "start": [-8.0, -8.0], "goal": [8.0, 8.0],
        "circles": circles, "boxes": [[0.0, 9.0, 4.0, 0.6, 30.0]],
    }  # fmt: skip


def _picture() -> str:
    sky = np.full((224, 224, 3), (170, 200, 230), np.uint8)
    sky[112:] = (120, 110, 90)
    sky[70:150, 40:80] = (60, 90, 50)
    buffer = io.BytesIO()
    Image.fromarray(sky).save(buffer, "JPEG")
    return base64.b64encode(buffer.getvalue()).decode()


def _bits(flags: np.ndarray) -> str:
    return base64.b64encode(np.packbits(flags).tobytes()).decode()


def main(endpoint: str, cars: str) -> None:
    """Play a run at a hub until this process is ended."""
    wake = threading.Event()
    with ZenohHub(endpoint) as hub:
        run = MadeUpRun(ZenohTransport(hub.endpoint), int(cars))
        print(hub.endpoint, flush=True)
        while True:
            run.step()
            wake.wait(0.02)


if __name__ == "__main__":
    main(*sys.argv[1:])
