import pytest

from zsdist import report
from zsdist.errors import RunError, WeightsError


def command(*arguments):
    return report.main(report.make_parser().parse_args([str(argument) for argument in arguments]))


def test_a_page_on_vision_shows_each_picture_that_it_names(tmp_path, capsys):
    assert command("--vision", "--images", 8, "--seed", 4, "--out", tmp_path / "page") == 0
    page = (tmp_path / "page" / "vision.md").read_text()
    drawn = {file.name for file in (tmp_path / "page").iterdir()} - {"vision.md"}
    assert {"vision-clearance.png", "vision-reliability.png", "vision-misses.jpg"} <= drawn
    assert all(f"({name})" in page for name in drawn)
    for heading in ("Loss", "Sets of pictures", "Table 3", "Attention of each action", "Worst misses"):
        assert f"\n## {heading}" in page
    assert "vision.md" in capsys.readouterr().out


def test_nothing_named_is_refused_with_what_is_allowed():
    with pytest.raises(RunError, match="--vision"):
        command()


def test_missing_weights_are_named(tmp_path):
    with pytest.raises(WeightsError, match="nowhere"):
        command("--vision", "--weights", tmp_path / "nowhere")


@pytest.mark.parametrize("wrong", [("--images", "0"), ("--seed", "-1"), ("--images", "some")])
def test_options_outside_their_range_are_refused_in_one_line(wrong, capsys):
    with pytest.raises(SystemExit) as left:
        command("--vision", *wrong)
    assert left.value.code == 2 and capsys.readouterr().err.count("\n") == 1
