import os

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zsdist.errors import DamagedError, RunError
from zsdist.replay import journal
from zsdist.replay.journal import Journal

RECORDS = [(1, b"first"), (2, b""), (255, bytes(range(256)))]


def reopened(folder):
    again = Journal(folder)
    return again, again.recover()


def flip(path, bit):
    content = bytearray(path.read_bytes())
    content[bit // 8] ^= 1 << bit % 8
    path.write_bytes(content)


def base_bytes(folder):
    return sum(path.stat().st_size for path in folder.iterdir() if path.suffix in (".base", ".copy"))


def test_a_new_journal_holds_nothing(tmp_path):
    assert Journal(tmp_path / "deep" / "journal").recover() is None


def test_base_and_records_are_recovered_in_order_though_the_writer_did_not_close(tmp_path):
    first = Journal(tmp_path)
    first.rebase(b"base")
    first.append(RECORDS[:2])
    first.append(RECORDS[2:])
    second, found = reopened(tmp_path)
    assert found == (b"base", [], RECORDS)
    assert second.nbytes == first.nbytes
    second.append([(7, b"more")])
    assert reopened(tmp_path)[1] == (b"base", [], [*RECORDS, (7, b"more")])


@settings(max_examples=60, deadline=None)
@given(contents=st.lists(st.binary(max_size=40), min_size=1, max_size=5), cut=st.integers(0, 600))
def test_a_torn_tail_is_cut_off_and_every_record_before_it_is_kept(tmp_path_factory, contents, cut):
    folder = tmp_path_factory.mktemp("journal")
    writer, ends = Journal(folder), []
    writer.rebase(b"")
    for content in contents:
        writer.append([(1, content)])
        ends.append((folder / "00000001.log").stat().st_size)
    size = min(cut, ends[-1])
    os.truncate(folder / "00000001.log", size)
    again, (_, _, records) = reopened(folder)
    whole = sum(end <= size for end in ends)
    assert records == [(1, content) for content in contents[:whole]] and not again.damage
    again.append([(2, b"after")])
    assert reopened(folder)[1].records == [*records, (2, b"after")]


def test_foreign_files_in_the_folder_are_ignored_and_stay(tmp_path):
    names = (".DS_Store", "._00000001.log", "00000009.base.orig", "notes.base", "copy of 00000003.log", "x.piece")
    for name in names:
        (tmp_path / name).write_text("not ours")
    (tmp_path / "lost+found").mkdir()
    assert Journal(tmp_path).recover() is None
    first = Journal(tmp_path)
    first.rebase(b"one")
    first.append(RECORDS)
    first.rebase(b"two", [b"rows"], end=3)
    first.append(RECORDS[:1])
    again, found = reopened(tmp_path)
    assert found == (b"two", [b"rows"], RECORDS[:1])
    again.rebase(b"three", end=3, oldest=3)
    assert {path.name for path in tmp_path.iterdir()} - {*names, "lost+found"} == {
        "00000003.base",
        "00000003.copy",
        "00000003.log",
    }
    assert all((tmp_path / name).read_text() == "not ours" for name in names)


def test_generations_are_in_order_of_their_numbers_beyond_eight_digits(tmp_path):
    Journal(tmp_path).rebase(b"old", [b"first"], end=3)
    for path in sorted(tmp_path.iterdir()):
        path.rename(tmp_path / path.name.replace("00000001", "99999999", 1))
    before, _ = reopened(tmp_path)
    before.rebase(b"new", [b"second"], end=6)
    assert {path.name.partition(".")[0] for path in tmp_path.glob("*.base")} == {"100000000"}
    assert reopened(tmp_path)[1] == (b"new", [b"first", b"second"], [])


def test_a_damaged_record_is_left_out_and_named_and_those_behind_it_are_kept(tmp_path):
    writer = Journal(tmp_path)
    writer.rebase(b"base")
    writer.append(RECORDS)
    flip(tmp_path / "00000001.log", 8 * (writer.nbytes - 300) + 3 - 8 * base_bytes(tmp_path))
    again, found = reopened(tmp_path)
    assert found.base == b"base" and len(found.records) == 2 and set(found.records) < set(RECORDS)
    (damage,) = again.damage
    assert damage.records == 1 and "00000001.log is damaged" in str(damage)
    again.append([(7, b"more")])
    assert reopened(tmp_path)[1].records == [*found.records, (7, b"more")]


@pytest.mark.parametrize("name", ["base", "copy"])
@pytest.mark.parametrize("damage", ["flip", "empty", "missing"])
def test_the_base_is_there_twice(tmp_path, name, damage):
    writer = Journal(tmp_path)
    writer.rebase(b"base", [b"rows"], end=4)
    writer.append(RECORDS)
    path = tmp_path / f"00000001.{name}"
    if damage == "flip":
        for bit in range(8 * path.stat().st_size):
            flip(path, bit)
            again, found = reopened(tmp_path)
            assert found == (b"base", [b"rows"], RECORDS) and [place.path for place in again.damage] == [path]
            flip(path, bit)
        flip(path, 77)
    elif damage == "empty":
        path.write_bytes(b"")
    else:
        path.unlink()
    again, found = reopened(tmp_path)
    assert found == (b"base", [b"rows"], RECORDS)
    assert [(place.path, place.records) for place in again.damage] == [(path, 0)]
    again.rebase(b"next", end=4)
    assert reopened(tmp_path)[1] == (b"next", [b"rows"], [])


def test_a_journal_without_any_whole_base_is_refused_in_one_line(tmp_path):
    Journal(tmp_path).rebase(b"base")
    for name in ("base", "copy"):
        flip(tmp_path / f"00000001.{name}", 200)
    with pytest.raises(DamagedError, match=f"replay journal {tmp_path} is damaged: neither copy of its base is whole"):
        reopened(tmp_path)


def test_a_damaged_part_of_a_piece_is_left_out_and_the_others_are_kept(tmp_path):
    writer = Journal(tmp_path)
    for end in (1, 2, 3):
        writer.rebase(b"base", [bytes([end, part]) * 10 for part in range(3)], end=end)
    path = tmp_path / "00000002-0000000000000002.piece"
    flip(path, 4 * path.stat().st_size)
    again, found = reopened(tmp_path)
    kept = [(1, 0), (1, 1), (1, 2), (2, 0), (2, 2), (3, 0), (3, 1), (3, 2)]
    assert found == (b"base", [bytes(part) * 10 for part in kept], [])
    assert [(place.path, place.records) for place in again.damage] == [(path, 1)]
    again.rebase(b"base", [b"more"], end=4)
    assert reopened(tmp_path)[1].pieces[-1] == b"more"


def test_a_piece_that_ends_early_is_damage(tmp_path):
    Journal(tmp_path).rebase(b"base", [b"first", b"second"], end=2)
    path = tmp_path / "00000001-0000000000000002.piece"
    os.truncate(path, path.stat().st_size - 1)
    again, found = reopened(tmp_path)
    assert found.pieces == [b"first"] and [place.path for place in again.damage] == [path]


def test_a_log_that_is_gone_is_damage(tmp_path):
    writer = Journal(tmp_path)
    writer.rebase(b"base")
    (tmp_path / "00000001.log").unlink()
    again, found = reopened(tmp_path)
    assert found == (b"base", [], []) and [place.path.name for place in again.damage] == ["00000001.log"]


def test_a_synced_journal_has_bases_and_pieces_on_the_disk_before_what_they_replace_is_removed(tmp_path, monkeypatch):
    synced, removed = [], []
    fsync, unlink = os.fsync, type(tmp_path).unlink
    monkeypatch.setattr(os, "fsync", lambda file: synced.append(os.readlink(f"/proc/self/fd/{file}")) or fsync(file))
    monkeypatch.setattr(type(tmp_path), "unlink", lambda path: removed.append((path.name, len(synced))) or unlink(path))
    for is_synced in (False, True):
        writer = Journal(tmp_path / str(is_synced), synced=is_synced)
        writer.rebase(b"base")
        synced.clear()
        removed.clear()
        writer.rebase(b"base", [b"rows"], end=3)
        assert len(synced) == (4 if is_synced else 0)  # piece, both copies of the base, the folder with their names
        assert {name for name, _ in removed} == {"00000001.base", "00000001.copy", "00000001.log"}
        assert {count for _, count in removed} == {len(synced)}


def test_a_new_base_replaces_all_before_it(tmp_path):
    writer = Journal(tmp_path)
    writer.rebase(b"one")
    writer.append(RECORDS)
    writer.rebase(b"two")
    assert writer.nbytes == base_bytes(tmp_path)
    assert reopened(tmp_path)[1] == (b"two", [], [])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["00000002.base", "00000002.copy", "00000002.log"]


def test_a_base_that_was_not_finished_does_not_count(tmp_path):
    writer = Journal(tmp_path)
    writer.rebase(b"one")
    writer.append(RECORDS)
    (tmp_path / "00000002.partial").write_bytes(b"tw")
    (tmp_path / "00000002-0000000000000005.piece").write_bytes(b"tor")
    again, found = reopened(tmp_path)
    assert found == (b"one", [], RECORDS)
    again.rebase(b"two", [b"piece"], end=6)
    assert reopened(tmp_path)[1] == (b"two", [b"piece"], [])


def test_pieces_stay_in_order_until_the_oldest_item_needed_is_beyond_their_end(tmp_path):
    writer = Journal(tmp_path)
    for end, piece in ((5, [b"5"]), (8, [b"8"]), (8, []), (30, [b"3", b"0"]), (1000, [b"1000"])):
        writer.rebase(b"base", piece, end=end)
    assert reopened(tmp_path)[1].pieces == [b"5", b"8", b"3", b"0", b"1000"]
    writer.append(RECORDS)
    writer.rebase(b"then", end=1000, oldest=8)
    again, found = reopened(tmp_path)
    assert found == (b"then", [b"3", b"0", b"1000"], [])
    assert again.nbytes == writer.nbytes == sum(path.stat().st_size for path in tmp_path.iterdir())
    again.rebase(b"last", end=1000, oldest=1000)
    assert reopened(tmp_path)[1] == (b"last", [], [])


def test_the_journal_stays_bounded_while_its_writer_rebases_when_due(tmp_path, monkeypatch):
    monkeypatch.setattr(journal, "COMPACT_BYTES", 10_000)
    writer, base = Journal(tmp_path), bytes(4_000)
    writer.rebase(base)
    largest = 0
    for number in range(300):
        writer.append([(1, bytes(500))])
        largest = max(largest, sum(path.stat().st_size for path in tmp_path.iterdir()))
        if writer.wants_base:
            writer.rebase(base, [bytes(2_000)], end=number, oldest=number - 50)
    assert largest < 10_000 + 2 * 4_000 + 600 + 4 * 2_100


def test_the_log_is_bounded_in_records_too(tmp_path, monkeypatch):
    monkeypatch.setattr(journal, "COMPACT_RECORDS", 5)
    writer = Journal(tmp_path)
    writer.rebase(b"base")
    writer.append([(1, b"")] * 3)
    assert not writer.wants_base
    successor, _ = reopened(tmp_path)
    successor.append([(1, b"")] * 2)
    assert successor.wants_base
    successor.rebase(b"base")
    assert not successor.wants_base


def test_a_journal_that_cannot_be_created_or_written_says_so(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RunError, match=r"replay journal .*file/journal cannot be created: Not a directory"):
        Journal(tmp_path / "file" / "journal")
    writer = Journal(tmp_path / "journal")
    writer.rebase(b"")
    writer.close()
    with pytest.raises(RunError, match="cannot be written: Bad file descriptor"):
        writer.append(RECORDS)


def test_a_full_disk_is_an_error_and_leaves_whole_records_only(tmp_path, monkeypatch):
    writer = Journal(tmp_path)
    writer.rebase(b"base")
    writer.append(RECORDS[:1])
    write = os.write
    monkeypatch.setattr(journal.os, "write", lambda file, content: write(file, content[:5]))
    with pytest.raises(RunError, match="the disk is full"):
        writer.append(RECORDS[1:])
    monkeypatch.undo()
    assert reopened(tmp_path)[1] == (b"base", [], RECORDS[:1])
