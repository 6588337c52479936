"""How long the tests of this folder take: `make endurance` runs them over 30 virtual days, `make test` over a few."""

import gc
import os
import sys
from dataclasses import dataclass

import pytest

MIB = 2**20
DAY_S = 86_400
BYTES_OF_AN_OBJECT = 80


@dataclass(frozen=True)
class Span:
    """Virtual time of a test, with as many episodes and merges a day as a run of 100,000 episodes in 30 days has."""

    days: int

    @property
    def episodes(self) -> int:
        return self.days * 100_000 // 30

    @property
    def merges(self) -> int:
        return self.episodes // 100


class Growth:
    """Growth of a process, from the first `note` to the last, per virtual day.

    Over a few days the objects are counted, as the memory itself goes up and down by some MiB; over many days the
    memory of the process is measured.
    """

    def __init__(self) -> None:
        self._noted: list[tuple[float, int, int]] = []

    def note(self, day: float) -> None:
        gc.collect()
        with open("/proc/self/statm") as file:
            resident = int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE")
        self._noted.append((day, sys.getallocatedblocks() * BYTES_OF_AN_OBJECT, resident))

    @property
    def mib_a_day(self) -> float:
        first, last = self._noted[0], self._noted[-1]
        measured = 2 if last[0] - first[0] > 5 else 1
        return (last[measured] - first[measured]) / MIB / (last[0] - first[0])


@pytest.fixture(scope="session")
def span():
    return Span(int(os.environ.get("ZSDIST_ENDURANCE_DAYS", "1")))


@pytest.fixture
def growth():
    return Growth()


@pytest.fixture
def report(capsys):
    """Function that prints figures, also where pytest shows no output."""

    def show(**figures: float) -> None:
        with capsys.disabled():
            print("\n  " + ", ".join(f"{name} {value:.4g}" for name, value in figures.items()))

    return show
