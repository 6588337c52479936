from xml.etree import ElementTree

import pytest
from hostile import NAMES
from made_runs import RESULT

from zsdist.common.console import plain
from zsdist.reporting import comparison, style
from zsdist.reporting.runs import Evaluation

PICTURED = [name for name in NAMES if len(name) < style.LONGEST_LABEL]


@pytest.mark.parametrize("name", NAMES)
def test_a_label_is_one_short_line_that_a_legend_keeps(name):
    label = style.label(name)
    assert len(label) <= style.LONGEST_LABEL + 1 and label.splitlines() == [label] and not label.startswith("_")
    if len(plain(name)) <= style.LONGEST_LABEL:
        assert label.removeprefix(" ") == plain(name).removeprefix(" ")


@pytest.mark.filterwarnings("ignore:Glyph")
def test_a_figure_shows_names_as_they_are(tmp_path):
    evaluations = [Evaluation(RESULT, name) for name in PICTURED]
    comparison.draw_policies([*evaluations, Evaluation({**RESULT, "scenes": "$x$ <b>"}, "other")], tmp_path)
    tree = ElementTree.parse(tmp_path / "policies.svg")
    shown = {"".join(text.itertext()).strip() for text in tree.iter("{http://www.w3.org/2000/svg}text")}
    assert {" ".join(plain(name).split()) for name in PICTURED} <= {" ".join(text.split()) for text in shown}
    assert "$x$ <b>" in shown


@pytest.mark.filterwarnings("ignore:Glyph")
def test_names_in_a_legend_are_shown_as_they_are_and_none_is_left_out():
    figure, (axes,) = style.panels(1, 1, 3.0, 3.0)
    for name in NAMES:
        axes.plot([0, 1], label=style.label(name))
    axes.set_title(style.label("$\\frac{1$"))
    legend = axes.legend()
    figure.draw_without_rendering()
    assert [text.get_text() for text in legend.get_texts()] == [style.label(name) for name in NAMES]
