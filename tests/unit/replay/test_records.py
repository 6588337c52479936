"""Records that survive damage around them."""

import random
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zsdist.replay import records
from zsdist.replay.records import MARKER_BYTES

MARKER, PATH = b"\x93\x02zs\xff\x00\x17q", Path("00000001.log")
HEAD_BYTES = len(records.head(MARKER, 0, 0, b""))


def written(contents, first=0):
    """Return the bytes of records, and the offset of each."""
    parts = [records.head(MARKER, first + number, kind, content) + content for number, (kind, content) in contents]
    return b"".join(parts), [sum(map(len, parts[:number])) for number in range(len(parts) + 1)]


def file_of(contents):
    return written(list(enumerate(contents)))


CONTENTS = [(number % 5, bytes([number]) * (40 * number)) for number in range(12)]


def test_records_are_read_as_they_were_written():
    content, _ = file_of(CONTENTS)
    assert records.read(content, MARKER, PATH) == (CONTENTS, len(content), 12, [])


@settings(max_examples=80, deadline=None)
@given(st.data())
def test_one_flipped_bit_costs_exactly_the_record_in_which_it_is(data):
    content, places = file_of(CONTENTS)
    bit = data.draw(st.integers(0, 8 * len(content) - 1))
    damaged = bytearray(content)
    damaged[bit // 8] ^= 1 << bit % 8
    found = records.read(bytes(damaged), MARKER, PATH)
    hit = sum(place <= bit // 8 for place in places) - 1
    assert found.records == CONTENTS[:hit] + CONTENTS[hit + 1 :]
    assert (found.end, found.next_number) == (len(content), 12)
    assert [(place.at, place.nbytes, place.records) for place in found.damage] == [
        (places[hit], places[hit + 1] - places[hit], 1)
    ]


@pytest.mark.parametrize("seed", range(30))
def test_zeroed_overwritten_and_missing_blocks_cost_the_records_in_them(seed):
    rng = random.Random(seed)
    content, places = file_of(CONTENTS)
    start = rng.randrange(len(content))
    stop = min(len(content), start + rng.choice((1, 40, 512)))
    middle = {0: bytes(stop - start), 1: rng.randbytes(stop - start), 2: b""}[seed % 3]
    found = records.read(content[:start] + middle + content[stop:], MARKER, PATH)
    whole = [CONTENTS[number] for number in range(12) if places[number + 1] <= start or places[number] >= stop]
    assert found.records == whole
    torn = stop > places[-2] and seed % 3 == 2  # a last record that lacks bytes may have been written when power failed
    assert found.damage or torn or len(whole) == 12
    if places[-2] >= stop:  # the last record is whole, so that the numbers tell how many are not
        assert sum(place.records for place in found.damage) == 12 - len(whole)


@pytest.mark.parametrize("cut", range(1, HEAD_BYTES + 20))
def test_an_unfinished_record_at_the_end_is_cut_and_is_no_damage(cut):
    content, places = file_of([(1, b"a" * 20), (2, b"b" * 20)])
    torn = content[: places[1] + cut]
    found = records.read(torn, MARKER, PATH)
    whole = cut == HEAD_BYTES + 20
    assert (found.end, found.damage, len(found.records)) == (len(torn) if whole else places[1], [], 1 + whole)


def test_nothing_that_a_sender_puts_into_a_record_passes_for_one():
    own, guessed = file_of([(1, b"stolen")])[0], records.head(bytes(MARKER_BYTES), 1, 1, b"forged") + b"forged"
    inner = own[:MARKER_BYTES] + guessed + own.replace(MARKER, bytes(MARKER_BYTES))
    content, places = file_of([(1, b"first"), (2, inner), (3, b"last")])
    damaged = bytearray(content)
    damaged[places[1]] ^= 1  # the way over the content is lost, so that it is searched
    found = records.read(bytes(damaged), MARKER, PATH)
    assert found.records == [(1, b"first"), (3, b"last")] and found.damage[0].records == 1


def test_a_record_from_an_earlier_place_of_the_file_is_not_read_again():
    content, places = file_of(CONTENTS)
    stale = content[places[2] : places[4]]
    found = records.read(content[: places[6]] + stale + content[places[6] :], MARKER, PATH)
    assert found.records == CONTENTS and len(found.damage) == 1
