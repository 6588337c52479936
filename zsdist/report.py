"""`python -m zsdist.report RUN...`: write a page with the paper's figures and tables, of runs or of vision."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from zsdist import config as configuration
from zsdist.common import cli, locks, output_files
from zsdist.common.console import PlainConsole, say
from zsdist.errors import RunError

if TYPE_CHECKING:
    from zsdist.reporting.runs import Material


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command's options."""
    parser = cli.Parser(prog="zsdist.report", description=__doc__)
    parser.add_argument(
        "runs",
        nargs="*",
        type=cli.path,
        metavar="RUN",
        help="run directories (several of one configuration: its seeds), and files or folders of evaluations",
    )
    page = "folder of the page (default: runs/report)"
    parser.add_argument("--out", type=cli.path, metavar="DIR", default=Path("runs/report"), help=page)
    html = "write the page as one HTML file too, with its pictures inside"
    parser.add_argument("--html", action="store_true", help=html)
    vision = parser.add_argument_group("vision, instead of runs")
    vision.add_argument("--vision", action="store_true", help="report on the visual-act model")
    vision.add_argument("--config", type=cli.configuration, metavar="FILE", help="preset or file: camera and weights")
    parser.add_set(vision)
    weights, seed = "folder of weights (default: vision.weights)", "seed of the pictures (default: 0)"
    parser.add_setting("--weights", "vision.weights", group=vision, metavar="DIR", help=weights)
    parser.add_setting("--seed", "seed", group=vision, type=cli.natural, metavar="S", help=seed)
    vision.add_argument("--images", type=cli.count, default=200, help="number of pictures in each set (default: 200)")
    return parser


def main(options: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    if bool(options.runs) == options.vision:
        raise RunError("name either run directories or --vision, not both and not neither")
    given = [name for name in ("config", "set", "weights", "seed") if getattr(options, name) not in (None, [])]
    if options.runs and given:
        raise RunError(f"--{given[0]} is for --vision; a run has its own configuration; remove the option")
    page = _write_vision(options) if options.vision else _write_runs(options)
    say(f"page: {page}")
    if options.html:
        from zsdist.reporting import html

        say(f"page: {html.write(page)}")
    return 0


def _write_runs(options: argparse.Namespace) -> Path:
    from zsdist.reporting import runs  # imports matplotlib and the simulator, which --help does not need

    material, console = runs.read(options.runs), PlainConsole(stderr=True)
    with _alone(options.out):
        return _write_page(material, options.out, console)


def _write_page(material: "Material", out: Path, console: PlainConsole) -> Path:
    from zsdist.reporting import page

    if not console.is_terminal:
        return page.write(material, out, lambda step: console.say(f"report: {step}"))
    with console.working("report") as show:
        return page.write(material, out, lambda step: show(f"report: {step}"))


def _write_vision(options: argparse.Namespace) -> Path:
    from zsdist.pretraining.check import report

    config = configuration.load(options.config, cli.overrides(options), lambda line: say(line, error=True))
    with _alone(options.out):
        return report.write(config, options.images, config.seed, options.out)


@contextmanager
def _alone(out: Path) -> Iterator[None]:
    """Make the folder of the page and lock it."""
    with output_files.made_folder(f"--out {out}", out), locks.held(out, f"--out {out}"):
        yield


if __name__ == "__main__":
    cli.execute(main, make_parser())
