from zsdist.run.episodes_file import EpisodesFile


def test_a_successor_appends_what_is_missing_and_nothing_twice(tmp_path):
    path = tmp_path / "episodes.jsonl"
    first = EpisodesFile(path)
    assert first.append({"finished_as": 1}) and first.append({"finished_as": 2})
    with path.open("a") as file:
        file.write('{"finished_as": 3, "epi')  # it died
    second = EpisodesFile(path)
    assert [second.append({"finished_as": number}) for number in (1, 2, 3, 4)] == [False, False, True, True]
    assert path.read_text() == "".join(f'{{"finished_as": {number}}}\n' for number in (1, 2, 3, 4))


def test_a_damaged_line_stays_and_the_one_before_it_counts(tmp_path):
    path = tmp_path / "episodes.jsonl"
    path.write_text('{"finished_as": 7}\nnonsense\n')
    assert not EpisodesFile(path).append({"finished_as": 7})
    assert path.read_text() == '{"finished_as": 7}\nnonsense\n'
