"""`python -m zsdist.report RUN...`: write a page with the paper's figures and tables, of runs or of vision."""

import argparse
from pathlib import Path

from zsdist import config as configuration
from zsdist.common import cli
from zsdist.common.console import PlainConsole, say
from zsdist.errors import RunError


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
    say(f"page: {page}")
    return 0


def _write_runs(options: argparse.Namespace) -> Path:
    from zsdist.reporting import page, runs  # imports matplotlib and the simulator, which --help does not need

    material, console = runs.read(options.runs), PlainConsole(stderr=True)
    if not console.is_terminal:
        return page.write(material, options.out, lambda step: console.say(f"report: {step}"))
    with console.working("report") as show:
        return page.write(material, options.out, lambda step: show(f"report: {step}"))


def _write_vision(options: argparse.Namespace) -> Path:
    from zsdist.pretraining.check import report

    overrides = (*options.set, *((f"vision.weights={options.weights}",) if options.weights else ()))
    config = configuration.load(options.config, overrides)
    return report.write(config, options.images, options.seed, options.out)


if __name__ == "__main__":
    cli.execute(main, make_parser())
