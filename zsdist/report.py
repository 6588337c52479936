"""`python -m zsdist.report RUN...`: write a page with the paper's figures and tables, of runs or of vision."""

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from zsdist import config as configuration
from zsdist.common import cli, locks, output_files
from zsdist.errors import RunError

if TYPE_CHECKING:
    from zsdist.reporting.runs import Material


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command's options."""
    parser = cli.Parser(prog="zsdist.report", description=__doc__)
    parser.add_argument(
        "runs",
        nargs="*",
        type=Path,
        metavar="RUN",
        help="run directories (several of one configuration: its seeds), and files or folders of evaluations",
    )
    parser.add_argument(
        "--out", type=Path, metavar="DIR", default=Path("runs/report"), help="folder of the page (default: runs/report)"
    )
    vision = parser.add_argument_group("vision, instead of runs")
    vision.add_argument("--vision", action="store_true", help="report on the visual-act model")
    vision.add_argument("--config", type=Path, metavar="FILE", help="YAML configuration: camera and weights")
    vision.add_argument("--set", action="append", default=[], metavar="KEY.PATH=VALUE", help="change one setting")
    vision.add_argument("--weights", metavar="DIR", help="folder of weights (default: vision.weights)")
    vision.add_argument("--seed", type=cli.natural, default=0, help="seed of the pictures (default: 0)")
    vision.add_argument("--images", type=cli.count, default=200, help="number of pictures in each set (default: 200)")
    return parser


def main(options: argparse.Namespace) -> int:
    """Run the command and return its exit status."""
    if bool(options.runs) == options.vision:
        raise RunError("name either run directories or --vision, not both and not neither")
    page = _write_vision(options) if options.vision else _write_runs(options)
    print(f"page: {page}")
    return 0


def _write_runs(options: argparse.Namespace) -> Path:
    from zsdist.reporting import runs  # imports matplotlib and the simulator, which --help does not need

    material, console = runs.read(options.runs), Console(stderr=True)
    with _alone(options.out):
        return _write_page(material, options.out, console)


def _write_page(material: "Material", out: Path, console: Console) -> Path:
    from zsdist.reporting import page

    if not console.is_terminal:
        return page.write(material, out, lambda step: console.print(f"report: {step}", highlight=False))
    with console.status("report") as status:
        return page.write(material, out, lambda step: status.update(f"report: {step}"))


def _write_vision(options: argparse.Namespace) -> Path:
    from zsdist.pretraining.check import report

    overrides = (*options.set, *((f"vision.weights={options.weights}",) if options.weights else ()))
    config = configuration.load(options.config, overrides)
    with _alone(options.out):
        return report.write(config, options.images, options.seed, options.out)


@contextmanager
def _alone(out: Path) -> Iterator[None]:
    """Make the folder of the page and lock it."""
    with output_files.written(f"--out {out}"):
        out.mkdir(parents=True, exist_ok=True)
        with locks.held(out, f"--out {out}"):
            yield


if __name__ == "__main__":
    cli.execute(main, make_parser())
