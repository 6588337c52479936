"""Drawing of a `RunView` on a terminal of any size: the larger it is, the more is shown."""

from collections.abc import Sequence

from rich.console import ConsoleOptions, RenderResult
from rich.text import Text

from zsdist.common.plain_lines import plain
from zsdist.telemetry.curves import CURVES, braille
from zsdist.telemetry.view import STARTING, RoleLine, RunView, duration

CELL = 39  # columns of a figure, a role or a curve, at least
LEAST_CURVE, LEAST_ROLES, LEAST_EVENTS = 5, 5, 3  # rows of each part, its heading included
TALL_CURVE = 9  # rows from which a second row of curves is shown
LABEL = 8  # columns of the numbers at a curve
_SIGNS = {"ok": ("●", "green"), STARTING: ("○", "yellow")}  # health is told by a word too, where it is not well
_ILL = ("✕", "bold red")


class RunScreen:
    """Picture of a run that fills the terminal, as something that rich prints.

    Args:
        view: what is shown.
    """

    def __init__(self, view: RunView) -> None:
        self.view = view

    def __rich_console__(self, console: object, options: ConsoleOptions) -> RenderResult:
        """Yield as many lines as the terminal has."""
        made = lines(self.view, options.max_width, options.height or options.max_height)
        yield Text("\n").join(made)


def lines(view: RunView, width: int, height: int) -> list[Text]:
    """Return a run as `height` lines, none wider than `width` cells."""
    head, columns = _head(view, width), max(1, width // CELL)
    figures = _grid([_pair(name, text) for name, text in view.figures.items()], width, columns)
    made, rest = [*head, *figures], height - len(head) - len(figures)
    if rest >= LEAST_CURVE + LEAST_ROLES + LEAST_EVENTS - 2:
        wanted = 1 + -(-len(view.roles) // columns)
        roles = min(wanted, max(LEAST_ROLES, rest * 2 // 5), rest - LEAST_CURVE - LEAST_EVENTS)
        events = min(1 + max(2, len(view.events)), max(LEAST_EVENTS, rest // 5))
        made += _curves(view, width, rest - roles - events)
        made += _roles(view.roles, width, roles)
        made += _events(view.events, width, events)
    made = [*made, *(Text() for _ in range(height))][:height]
    for line in made:
        line.truncate(width, overflow="ellipsis", pad=True)
    return made


def _head(view: RunView, width: int) -> list[Text]:
    since = duration(view.clock.age_s) + ("" if view.clock.known else " watched")
    left = "" if view.left_s is None else f", about {duration(view.left_s)} left"
    title = _ends(Text.assemble("zsdist ", (plain(view.run), "bold")), Text(since + left), width)
    counts = f" {view.episodes} of {'?' if view.target is None else view.target} episodes"
    share = view.episodes / view.target if view.target else 0.0
    room = max(10, width - len(counts))
    full = min(room, round(share * room))
    bar = Text.assemble(("━" * full, "green"), ("─" * (room - full), "dim"), counts)
    state = Text.assemble(("stage ", "bold"), plain(view.state), ("   waiting ", "bold"), plain(view.waiting))
    return [title, bar, state]


def _curves(view: RunView, width: int, height: int) -> list[Text]:
    """Return as many curves as there is room for, side by side."""
    across = min(len(CURVES), max(1, width // CELL))
    down = 2 if height >= 2 * TALL_CURVE and across < len(CURVES) else 1
    made: list[Text] = []
    across = min(across, -(-len(CURVES) // down))
    names = list(CURVES)[: across * down]
    for row in range(down):
        tall = height // down if row < down - 1 else height - len(made)
        shown = names[row * across : (row + 1) * across]
        blocks = [_curve(view, name, width // across - 1, tall) for name in shown]
        made += [_beside(cells, width // across) for cells in zip(*blocks, strict=True)] if blocks else []
    return made


def _curve(view: RunView, name: str, width: int, height: int) -> list[Text]:
    points = view.history.points(name)
    heading = _heading(f"{CURVES[name]}{f'  {points[-1][1]:.4g}' if points else ''}", width)
    rows, columns = height - 1, width - LABEL - 1
    if len(points) < 2 or columns < 4:
        told = Text("drawn from the second episode on", "dim")
        return [heading, told, *(Text() for _ in range(rows - 1))][:height]
    drawn = braille(points, columns, rows)
    low, high = min(y for _, y in points), max(y for _, y in points)
    labels = [f"{high:.3g}", *[""] * (rows - 2), f"{low:.3g}"] if rows > 1 else [f"{high:.3g}"]
    body = [
        Text.assemble((label[:LABEL].rjust(LABEL) + " ", "dim"), (dots, "cyan"))
        for label, dots in zip(labels, drawn, strict=True)
    ]
    return [heading, *body]


def _roles(roles: Sequence[RoleLine], width: int, height: int) -> list[Text]:
    columns = max(1, width // CELL)
    room = (height - 1) * columns
    ill = sum(not line.well for line in roles)
    begin = sum(line.health == STARTING for line in roles)
    counts = f"{len(roles)} roles: " + ", ".join(
        [
            f"{len(roles) - ill - begin} well",
            *([f"{begin} starting"] if begin else []),
            *([f"{ill} ill"] if ill else []),
        ]
    )
    shown = list(roles) if len(roles) <= room else list(roles[: room - 1])
    cells = [_role(line) for line in shown]
    if len(shown) < len(roles):
        cells.append(Text(f"and {len(roles) - len(shown)} more", "dim"))
    made = [_heading(counts, width), *_grid(cells, width, columns)]
    return [*made, *(Text() for _ in range(height))][:height]


def _role(line: RoleLine) -> Text:
    sign, style = _SIGNS.get(line.health, _ILL)
    health = "" if line.health == "ok" else f"{line.health} "
    return Text.assemble((f"{sign} ", style), f"{line.name:<12} ", (health, style), plain(line.telling))


def _events(events: Sequence[str], width: int, height: int) -> list[Text]:
    newest = [Text(plain(event)) for event in events[-(height - 1) :]] or [Text("none yet", "dim")]
    return [_heading("events", width), *newest, *(Text() for _ in range(height))][:height]


def _heading(text: str, width: int) -> Text:
    return Text.assemble((text, "bold"), " ", ("─" * max(0, width - len(text) - 1), "dim"))


def _pair(name: str, text: str) -> Text:
    return Text.assemble((name, "bold"), " ", plain(text))


def _grid(cells: Sequence[Text], width: int, columns: int) -> list[Text]:
    """Return cells in columns of equal width, row by row."""
    rows = [cells[start : start + columns] for start in range(0, len(cells), columns)]
    return [_beside(row, width // columns) for row in rows]


def _beside(cells: Sequence[Text], width: int) -> Text:
    """Return cells side by side, each `width` wide with at least one space behind it."""
    line = Text()
    for cell in cells:
        shown = cell.copy()
        shown.truncate(width - 1, overflow="ellipsis", pad=True)
        line.append_text(shown).append(" ")
    return line


def _ends(left: Text, right: Text, width: int) -> Text:
    """Return a line with a text at each end."""
    room = width - right.cell_len - 1
    shown = left.copy()
    shown.truncate(max(1, room), overflow="ellipsis", pad=True)
    return Text.assemble(shown, " ", right)
