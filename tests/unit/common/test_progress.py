from zsdist.common import progress


def test_without_a_terminal_there_are_plain_lines_and_not_too_many(capsys, monkeypatch):
    with progress.StepProgress("film", 3, done=1) as shown:
        shown.step()
    assert capsys.readouterr().err == ""
    monkeypatch.setattr(progress, "PLAIN_EVERY_S", -1.0)
    with progress.StepProgress("film", 3, done=1) as shown:
        shown.step()
        shown.step("last")
    assert capsys.readouterr().err.splitlines() == ["film: 2 of 3", "film: 3 of 3: last"]


def test_on_a_terminal_there_is_a_bar(capsys, monkeypatch):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with progress.StepProgress("film", 2) as shown:
        shown.step("on its way")
    assert "film" in capsys.readouterr().err
