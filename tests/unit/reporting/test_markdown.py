from zsdist.reporting.markdown import figure, missing, table


def test_a_table_in_markdown_has_a_cell_for_each_column():
    lines = table(["a", "b"], [["x", "1"], ["y", "2"]])
    assert lines == ["| a | b |", "| --- | ---: |", "| x | 1 |", "| y | 2 |", ""]


def test_a_figure_is_shown_with_its_caption_and_as_a_drawing():
    lines = figure("paths.png", "Paths. Of two cars.")
    assert lines[0] == "![Paths](paths.png)"
    assert "*Paths. Of two cars.*" in lines[2] and "(paths.svg)" in lines[2]


def test_what_is_missing_is_named_with_the_reason():
    assert missing("it, as there is none") == ["Left out: it, as there is none.", ""]
