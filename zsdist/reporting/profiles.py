"""Section of a report on where the time of each role went, from the profiles of `zsdist.launch --profile`."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from zsdist.errors import RunError
from zsdist.reporting import style
from zsdist.reporting.markdown import code, figure, missing, table
from zsdist.reporting.runs import Run
from zsdist.run import profiling

SHOWN_PARTS = 7  # all others are one
SHOWN_FUNCTIONS = 12
OTHER = "other"

Times = Mapping[str, Counter[str]]  # microseconds of each part, by role


def section(runs: Sequence[Run], out: Path) -> list[str]:
    """Return the lines of the section, and draw its figure for the first run with a profile.

    Raises:
        RunError: a profile is damaged.
    """
    for run in runs:
        if profile := _read(run.folder):
            parts = {role: _by_part(stacks) for role, stacks in profile.items()}
            caption = (
                f"Time of each role of {run.folder.name}, by the part of zsdist that it was spent in, with the "
                "libraries that the part calls. Waiting: nothing to do. Sampled a hundred times a second."
            )
            return [*figure(draw(parts, out), caption), *_functions(profile)]
    return missing("no run with a profile was given (zsdist.launch --profile)")


def _read(folder: Path) -> dict[str, Counter[tuple[str, ...]]]:
    try:
        return profiling.read(folder)
    except ValueError as error:
        raise RunError(f"the profile in {folder / profiling.FOLDER} is damaged: {error}; remove that folder") from error


def _by_part(stacks: Mapping[tuple[str, ...], int]) -> Counter[str]:
    times: Counter[str] = Counter()
    for stack, time_us in stacks.items():
        times[profiling.part(stack)] += time_us
    return times


def draw(times: Times, folder: Path) -> str:
    """Draw the shares of the parts, a bar for each role; return the name of the file.

    Args:
        times: microseconds of each part, by role.
        folder: folder of the figure.
    """
    busy: Counter[str] = Counter()
    for parts in times.values():
        busy.update({part: time_us / max(1, parts.total()) for part, time_us in parts.items()})
    del busy[profiling.WAITING]
    shown = [part for part, _ in busy.most_common(SHOWN_PARTS)]
    colours = dict(zip(shown, style.CYCLE, strict=False)) | {OTHER: style.GREY, profiling.WAITING: style.PALE}
    figure, (axes,) = style.panels(1, 1, 8.0, 0.9 + 0.35 * len(times))
    roles = sorted(times)
    left = [0.0] * len(roles)
    for part in [*shown, OTHER, profiling.WAITING]:
        shares = [_share(times[role], part, shown) for role in roles]
        axes.barh(roles, shares, left=left, color=colours[part], label=part, height=0.7)
        left = [before + share for before, share in zip(left, shares, strict=True)]
    axes.set(xlim=(0, 1), xlabel="share of the role's time")
    axes.invert_yaxis()
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
    return style.save(figure, folder, "profile")


def _share(parts: Counter[str], part: str, shown: Sequence[str]) -> float:
    named = {*shown, profiling.WAITING}
    time_us = sum(us for name, us in parts.items() if name not in named) if part == OTHER else parts[part]
    return time_us / max(1, parts.total())


def _functions(profile: Mapping[str, Counter[tuple[str, ...]]]) -> list[str]:
    """Return a table of the innermost functions with the most time, over all roles, in seconds."""
    times: Counter[str] = Counter()
    for stacks in profile.values():
        for stack, time_us in stacks.items():
            times[stack[-1]] += time_us
    del times[profiling.WAITING]
    rows = [[code(name), f"{time_us / 1e6:.1f}"] for name, time_us in times.most_common(SHOWN_FUNCTIONS)]
    return table(("innermost function, all roles", "seconds"), rows) if rows else []
