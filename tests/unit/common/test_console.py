import io
import subprocess
import sys

import pytest
from hostile import NAMES

from zsdist.common import console
from zsdist.common.console import PlainConsole, plain


def printed(show, width=80, **options):
    """Return what a function of a console prints."""
    out = io.StringIO()
    show(PlainConsole(file=out, width=width, **options))
    return out.getvalue()


def on_a_terminal(show, encoding="utf-8"):
    """Return the bytes that a function of a console writes to a terminal of an encoding."""
    raw = io.BytesIO()
    stream = io.TextIOWrapper(raw, encoding=encoding)
    show(PlainConsole(file=stream, width=40, force_terminal=True, color_system=None))
    stream.flush()
    return raw.getvalue()


def cells(text):
    """Return the text of a table of one column, put together from its lines."""
    return "".join(line.removesuffix(" ") for line in text.splitlines()[2:])


@pytest.mark.parametrize("name", NAMES)
def test_a_plain_text_is_one_line_that_says_all_and_does_nothing(name):
    shown = plain(name)
    assert len(shown.splitlines()) == 1 and all(char.isprintable() or char == "\u200d" for char in shown)
    shown.encode()
    assert plain(shown) == shown
    if name.isprintable():
        assert shown == name


def test_what_cannot_be_seen_is_shown_as_an_escape():
    assert plain("a\nb\tc\x1b[0m\udcff\u202e\x9b") == r"a\nb\tc\x1b[0m\xff\u202e\x9b"


@pytest.mark.parametrize("name", NAMES)
def test_every_way_to_print_shows_a_name_as_it_is(name, capsys):
    assert printed(lambda out: out.print(name), width=1000) == plain(name) + "\n"
    assert printed(lambda out: out.say(name), width=10) == plain(name) + "\n"
    assert printed(lambda out: out.say("in ", (name, "bold red"), "."), width=10) == f"in {plain(name)}.\n"
    for error in (False, True):
        console.say(name, error=error)
    assert capsys.readouterr() == (plain(name) + "\n", plain(name) + "\n")


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("width", [40, 400])
def test_a_cell_shows_a_name_whole_and_keeps_the_figures_beside_it(name, width):
    head = ("policy", "success", "95%")
    text = printed(lambda out: out.print(console.table(head, [(name, "0.123", "0.100 to 0.200")])), width=width)
    assert all(len(line) <= width for line in text.splitlines())
    assert "0.123" in text and "0.100 to 0.200" in text
    alone = printed(lambda out: out.print(console.table(["name"], [(name,)])), width=width)
    squeezed = ["".join(shown.split()) for shown in (cells(alone), plain(name))]
    assert squeezed[0] == squeezed[1]


def test_the_longest_names_and_figures_of_a_comparison_fit_beside_each_other_on_80_columns():
    head = ("scenes", "policy", "n", "success", "collision", "timeout", "SPL")
    row = ("ood-start-goal", "potential-field", "10", "0.20 (0.06-0.51)", "0.00", "0.80", "0.15")
    text = printed(lambda out: out.print(console.table(head, [row], words=2)))
    assert all(cell in text for cell in (*head, *row))


@pytest.mark.parametrize("name", NAMES)
def test_bars_and_status_show_a_name_without_obeying_it(name):
    def show(out):
        with console.bars(out) as bars:
            bars.add_task(name, total=2)
        with out.working(name) as change:
            change(f"now {name}")

    written = on_a_terminal(show).decode()
    for sequence in ("\x1b[31m", "\x1b]", "\x9b", "\x00", "\u202e"):
        assert sequence not in written
    if len(plain(name)) < 10:
        assert plain(name) in written


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "utf-8"])
def test_an_output_that_lacks_a_character_gets_an_escape(encoding):
    for name in NAMES:
        on_a_terminal(lambda out, name=name: (out.say(name), out.print(console.table([name], [(name,)]))), encoding)
    assert on_a_terminal(lambda out: out.say("a−b"), "ascii").rstrip() == rb"a\u2212b"


def test_lines_of_any_text_are_printed_where_the_locale_is_ascii():
    code = "from zsdist.common.console import say; say('−\\udcff'); say('é', error=True)"
    environment = {"PYTHONIOENCODING": "ascii:strict", "PYTHONPATH": ":".join(sys.path)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True, env=environment)
    assert done.stdout == b"\\u2212\\xff\n" and done.stderr == b"\\xe9\n"
