import pytest
from bundles import damaged

from zsdist import export
from zsdist.common import cli


def run(*arguments):
    with pytest.raises(SystemExit) as exit_:
        cli.execute(export.main, export.make_parser(), [str(argument) for argument in arguments])
    return exit_.value.code


def test_a_check_says_in_one_line_that_the_bundle_passes(small_bundle, capsys):
    assert run("--check", small_bundle) == 0
    assert capsys.readouterr().out.startswith(f"bundle {small_bundle} passes: the same decisions in all 12 steps")


def test_a_check_of_another_version_fails_in_one_line(small_bundle, tmp_path, capsys):
    assert run("--check", damaged(small_bundle, tmp_path, lambda about: about.update(zsdist="9.9"))) == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([], "a policy and a folder are needed"),
        (["pretrained"], "a policy and a folder are needed"),
        (["pretrained", "--check", "x"], "allowed is --check DIR alone"),
        (["--out", "y", "--check", "x"], "allowed is --check DIR alone"),
        (["astar", "--out", "y"], "policy 'astar' is no folder"),
        (["pretrained", "--out", "y", "--set", "agent.influence_m=2"], "allowed are settings of camera and vision"),
        (["pretrained", "--out", "y", "--set", "vision.encoder=/absent"], "vision.encoder"),
        (["pretrained", "--out", "."], "exists already"),
        (["pretrained", "--out", "y", "--evaluation", "absent.json"], "absent.json cannot be read"),
    ],
)
def test_what_cannot_be_exported_is_refused_in_one_line(tmp_path, monkeypatch, capsys, arguments, words):
    (tmp_path / "file").touch()
    monkeypatch.chdir(tmp_path)
    assert run(*arguments) == 2
    said = capsys.readouterr().err
    assert words in said and said.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file"]
