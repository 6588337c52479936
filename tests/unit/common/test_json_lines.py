import json

from zsdist.common import json_lines


def test_stale_and_unfinished_lines_are_removed_and_the_others_kept_byte_for_byte(tmp_path):
    file = tmp_path / "training.jsonl"
    lines = [{"stage": stage, "epoch": epoch} for stage in ("words", "head") for epoch in (1, 2, 3)]
    texts = [json.dumps(line, separators=(",", " : ")) + "\n" for line in lines]
    file.write_text("".join(texts) + '{"stage": "he')
    json_lines.prune(file, lambda line: line["stage"] == "head" and line["epoch"] > 1)
    assert file.read_text() == "".join(texts[:4])


def test_lines_without_the_key_that_decides_are_removed(tmp_path):
    file = tmp_path / "episodes.jsonl"
    file.write_text('{"episode": 1}\n{"other": 1}\n')
    json_lines.prune(file, lambda record: record["episode"] > 1)
    assert file.read_text() == '{"episode": 1}\n'


def test_a_file_that_does_not_exist_is_not_made(tmp_path):
    json_lines.prune(tmp_path / "none.jsonl", lambda record: True)
    assert list(tmp_path.iterdir()) == []
