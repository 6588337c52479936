"""Output of all commands: any text is shown as it is, whatever it contains.

Names of files, runs and scenes come from users and peers. A console that reads markup would swallow `[red]`, and a
terminal would obey escape sequences. Here nothing reads markup, and what cannot be seen is shown as an escape.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, Task, TimeElapsedColumn
from rich.progress import TimeRemainingColumn as TimeLeftColumn
from rich.table import Table
from rich.text import Text

from zsdist.common.plain_lines import plain as plain
from zsdist.common.plain_lines import say as say


class PlainConsole(Console):
    """Console of rich that shows every text as it is: without markup, emoji codes and highlighting.

    Args:
        options: as those of `rich.console.Console`, except those that change texts.
    """

    def __init__(self, **options: Any) -> None:
        super().__init__(**options, markup=False, emoji=False, highlight=False)

    def render_str(self, text: str, **options: Any) -> Text:
        """Return a plain text for a string that is printed or stands in a table."""
        return super().render_str(self._encodable(plain(text)), **options)

    def say(self, *parts: str | tuple[str, str]) -> None:
        """Print one line, which is never cut or folded.

        Args:
            parts: texts, and pairs of a text and its style, such as `("ok", "green")`.
        """
        pairs = [(part, "") if isinstance(part, str) else part for part in parts]
        whole = Text.assemble(*((self._encodable(plain(text)), style) for text, style in pairs))
        self.print(whole, soft_wrap=True)

    @contextmanager
    def working(self, text: str) -> Iterator[Callable[[str], None]]:
        """Show a turning mark with a text; yield the function that changes the text."""
        with self.status(Text(plain(text))) as status:
            yield lambda changed: status.update(Text(plain(changed)))

    def _encodable(self, text: str) -> str:
        """Return a text without characters that the output's encoding lacks."""
        return text.encode(self.encoding, "backslashreplace").decode(self.encoding)


def table(headings: Sequence[str], rows: Iterable[Sequence[str]], *, words: int = 1) -> Table:
    """Return a table whose figures are never cut; long words are folded.

    A title of any length is printed by `PlainConsole.say` before it.

    Args:
        headings: headings of the columns.
        rows: texts of the cells, row by row.
        words: number of first columns that hold words instead of figures.
    """
    made = Table(box=SIMPLE_HEAD, show_edge=False, pad_edge=False, collapse_padding=True)
    for index, heading in enumerate(headings):
        is_word = index < words
        made.add_column(heading, justify="left" if is_word else "right", overflow="fold", no_wrap=not is_word)
    for row in rows:
        made.add_row(*row)
    return made


def pairs_table(pairs: Iterable[tuple[str, str]]) -> Table:
    """Return a table without headings: bold names, and their values."""
    made = Table(show_header=False)
    made.add_column(style="bold", no_wrap=True)
    made.add_column(min_width=32, overflow="fold")
    for name, value in pairs:
        made.add_row(name, value)
    return made


class _Description(ProgressColumn):
    """Description of a task, as it is."""

    def render(self, task: Task) -> Text:
        return Text(plain(task.description), overflow="ellipsis", no_wrap=True)


def bars(console: PlainConsole, *, remaining: bool = False, transient: bool = False) -> Progress:
    """Return bars with description, count and time.

    Args:
        console: console of the bars.
        remaining: whether to show the remaining time instead of the elapsed time.
        transient: whether the bars vanish at the end.
    """
    clock = TimeLeftColumn() if remaining else TimeElapsedColumn()
    return Progress(_Description(), BarColumn(), MofNCompleteColumn(), clock, console=console, transient=transient)
