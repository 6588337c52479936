import shlex

import pytest

from zsdist import pretrain
from zsdist.errors import ConfigError, DataError, RunError
from zsdist.pretraining import job
from zsdist.vision.weights_folder import METADATA_FILE


def command(*arguments):
    return pretrain.main(pretrain.make_parser().parse_args([str(argument) for argument in arguments]))


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        (("--families", "meadow"), "'meadow', which is not a scene family; allowed are street, varied"),
        (("--families", "street,ood-layout"), "'ood-layout', which is withheld from the training of vision.*test"),
        (("--stages", "feet"), "'feet'; allowed are words, head, student, compact"),
        (("--stages", "student"), "student without head"),
    ],
)
def test_impossible_families_and_stages_are_refused_with_the_reason(wrong, reason, tmp_path):
    with pytest.raises(ConfigError, match=reason):
        command("--out", tmp_path / "new", *wrong)
    assert not (tmp_path / "new").exists()


def test_an_empty_folder_of_photographs_is_refused_before_anything_is_made(tmp_path):
    with pytest.raises(DataError, match=str(tmp_path)):
        command("--cityscapes", tmp_path, "--out", tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_folder_that_holds_a_pretraining_or_weights_is_left_alone(tmp_path):
    (tmp_path / METADATA_FILE).write_text("{}")
    with pytest.raises(RunError, match="finished weights"):
        command("--images", 16, "--out", tmp_path)
    (tmp_path / job.JOB_FILE).write_text("{}")
    with pytest.raises(RunError, match="--resume"):
        command("--images", 16, "--out", tmp_path)


def test_what_cannot_be_resumed_is_reported(tmp_path):
    with pytest.raises(RunError, match="holds no pretraining"):
        command("--resume", tmp_path)
    with pytest.raises(ConfigError, match="--images cannot be combined with --resume"):
        command("--resume", tmp_path, "--images", 16)
    (tmp_path / job.JOB_FILE).write_text("{}")
    with pytest.raises(RunError, match="is damaged"):
        command("--resume", tmp_path)


def test_pictures_for_which_there_is_no_room_are_refused(tmp_path):
    with pytest.raises(RunError, match="GB are free"):
        command("--images", 10**10, "--out", tmp_path / "new")


@pytest.mark.parametrize("wrong", [("--images", "0"), ("--minutes", "-1"), ("--epochs", "many"), ("--seed", "-1")])
def test_options_outside_their_range_are_refused_in_one_line(wrong, capsys):
    with pytest.raises(SystemExit) as left:
        command(*wrong)
    assert left.value.code == 2 and capsys.readouterr().err.count("\n") == 1


def test_the_command_that_resumes_has_the_options_that_the_folder_does_not_keep(tmp_path, monkeypatch, capsys):
    def interrupted(*arguments):
        raise KeyboardInterrupt

    monkeypatch.setattr("zsdist.pretraining.train.train", interrupted)
    monkeypatch.chdir(tmp_path)
    given = ("--keep-pictures", "--minutes", "3", "--workers", "1", "--json", "a b.json", "--plain")
    assert command("--images", "16", "--out", "my weights", *given) == 130
    words = shlex.split(capsys.readouterr().out.splitlines()[-1])
    assert words[1:3] == ["-m", "zsdist.pretrain"]
    again = pretrain.make_parser().parse_args(words[3:])
    assert again.resume == tmp_path / "my weights" and again.json == tmp_path / "a b.json"
    assert (again.keep_pictures, again.minutes, again.workers, again.plain) == (True, 3.0, 1, True)
    assert command(*words[3:]) == 130
