"""`python -m zsdist.report --vision`: what trained vision sees and where it errs, as a page with pictures."""

import argparse
from pathlib import Path

from zsdist import cli
from zsdist import config as configuration
from zsdist.errors import RunError


def make_parser() -> argparse.ArgumentParser:
    """The command's options."""
    parser = cli.Parser(prog="zsdist.report", description=__doc__)
    parser.add_argument("--out", type=Path, metavar="DIR", default=Path("runs/report"), help="folder of the page")
    parser.add_argument("--config", type=Path, metavar="FILE", help="camera, and weights")
    parser.add_argument("--set", action="append", default=[], metavar="KEY.PATH=VALUE", help="change a setting")
    vision = parser.add_argument_group("vision")
    vision.add_argument("--vision", action="store_true", help="report on the visual-act model")
    vision.add_argument("--weights", metavar="DIR", help="folder of weights (default: vision.weights)")
    vision.add_argument("--seed", type=cli.natural, default=0, help="of the pictures (default: 0)")
    vision.add_argument("--images", type=cli.count, default=200, help="pictures of each set (default: 200)")
    return parser


def main(options: argparse.Namespace) -> int:
    """Runs the command; returns its exit status."""
    if not options.vision:
        raise RunError("nothing to report on was named; allowed is --vision")
    from zsdist.pretraining import vision_report  # imports matplotlib, which --help does without

    overrides = (*options.set, *((f"vision.weights={options.weights}",) if options.weights else ()))
    config = configuration.load(options.config, overrides)
    print(f"the page is {vision_report.write(config, options.images, options.seed, options.out)}")
    return 0


if __name__ == "__main__":
    cli.execute(main, make_parser())
