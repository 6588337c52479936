from zsdist.run.last_words import RoleLog


def test_last_words_are_the_last_line_since_the_start_of_this_incarnation(tmp_path):
    path = tmp_path / "actor-0.log"
    first = RoleLog(path)
    assert first.last_words() == ""
    assert first.named_in("it died") == "it died"
    path.write_text("Traceback\n  File\nMemoryError: 3 GB\n\n")
    assert first.last_words() == "MemoryError: 3 GB"
    second = RoleLog(path)
    assert second.last_words() == ""
    with path.open("ab") as file:
        file.write(b"\xff\x1b[31mfree(): invalid pointer\x1b[0m")
    assert second.last_words().endswith("free(): invalid pointer[0m")
    assert second.last_words().isprintable()
    assert second.named_in("it died") == f"it died; its log is {path}"


def test_last_words_are_short(tmp_path):
    path = tmp_path / "actor-0.log"
    log = RoleLog(path)
    path.write_text("x" * 10**6)
    assert 0 < len(log.last_words()) <= 300
