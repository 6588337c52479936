import os

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zsdist.errors import RunError
from zsdist.replay import journal
from zsdist.replay.journal import Journal

RECORDS = [(1, b"first"), (2, b""), (255, bytes(range(256)))]


def reopened(folder):
    again = Journal(folder)
    return again, again.recover()


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
@given(contents=st.lists(st.binary(max_size=40), min_size=1, max_size=5), cut=st.integers(0, 400))
def test_a_torn_tail_is_cut_off_and_every_record_before_it_is_kept(tmp_path_factory, contents, cut):
    folder = tmp_path_factory.mktemp("journal")
    writer, ends = Journal(folder), []
    writer.rebase(b"")
    for content in contents:
        writer.append([(1, content)])
        ends.append(writer.nbytes)
    size = min(cut, ends[-1])
    os.truncate(folder / "00000001.log", size)
    again, (_, _, records) = reopened(folder)
    whole = sum(end <= size for end in ends)
    assert records == [(1, content) for content in contents[:whole]]
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
    first.rebase(b"two", b"rows", end=3)
    first.append(RECORDS[:1])
    again, found = reopened(tmp_path)
    assert found == (b"two", [b"rows"], RECORDS[:1])
    again.rebase(b"three", end=3, oldest=3)
    assert {path.name for path in tmp_path.iterdir()} - {*names, "lost+found"} == {"00000003.base", "00000003.log"}
    assert all((tmp_path / name).read_text() == "not ours" for name in names)


def test_generations_are_in_order_of_their_numbers_beyond_eight_digits(tmp_path):
    for name, content in (
        ("99999999.base", b"old"),
        ("100000000.base", b"new"),
        ("99999999-0000000000000003.piece", b"first"),
        ("100000000-0000000000000006.piece", b"second"),
    ):
        (tmp_path / name).write_bytes(content)
    assert Journal(tmp_path).recover() == (b"new", [b"first", b"second"], [])


def test_recovery_stops_at_a_damaged_record(tmp_path):
    writer = Journal(tmp_path)
    writer.rebase(b"base")
    writer.append(RECORDS)
    content = bytearray((tmp_path / "00000001.log").read_bytes())
    content[-1] ^= 1
    (tmp_path / "00000001.log").write_bytes(content)
    assert reopened(tmp_path)[1] == (b"base", [], RECORDS[:2])


def test_a_new_base_replaces_all_before_it(tmp_path):
    writer = Journal(tmp_path)
    writer.rebase(b"one")
    writer.append(RECORDS)
    writer.rebase(b"two")
    assert writer.nbytes == 3
    assert reopened(tmp_path)[1] == (b"two", [], [])
    assert sorted(path.name for path in tmp_path.iterdir()) == ["00000002.base", "00000002.log"]


def test_a_base_that_was_not_finished_does_not_count(tmp_path):
    writer = Journal(tmp_path)
    writer.rebase(b"one")
    writer.append(RECORDS)
    (tmp_path / "00000002.partial").write_bytes(b"tw")
    (tmp_path / "00000002-0000000000000005.piece").write_bytes(b"tor")
    again, found = reopened(tmp_path)
    assert found == (b"one", [], RECORDS)
    again.rebase(b"two", b"piece", end=6)
    assert reopened(tmp_path)[1] == (b"two", [b"piece"], [])


def test_pieces_stay_in_order_until_the_oldest_item_needed_is_beyond_their_end(tmp_path):
    writer = Journal(tmp_path)
    for end, piece in ((5, b"5"), (8, b"8"), (8, b""), (30, b"30"), (1000, b"1000")):
        writer.rebase(b"base", piece, end=end)
    assert reopened(tmp_path)[1].pieces == [b"5", b"8", b"30", b"1000"]
    writer.append(RECORDS)
    writer.rebase(b"then", end=1000, oldest=8)
    again, found = reopened(tmp_path)
    assert found == (b"then", [b"30", b"1000"], [])
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
            writer.rebase(base, bytes(2_000), end=number, oldest=number - 50)
    assert largest < 10_000 + 4_000 + 600 + 4 * 2_000


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
