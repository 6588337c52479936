"""`python -m zsdist.doctor`: check this machine and a cluster's addresses; report what is wrong and what to do."""

import argparse
import json

from zsdist.common import cli
from zsdist.common.console import PlainConsole
from zsdist.diagnostics import suite
from zsdist.diagnostics.result import CheckResult, CheckStatus

COLOURS = {CheckStatus.OK: "green", CheckStatus.WARN: "yellow", CheckStatus.FAIL: "red"}


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command's options."""
    parser = cli.Parser(prog="zsdist.doctor", description=__doc__)
    parser.add_argument("--address", metavar="RAY", help="also check this Ray cluster: HOST:PORT or auto")
    parser.add_argument("--endpoint", help="also check this endpoint of the cluster's hub (transport.endpoint)")
    parser.add_argument("--tls", type=cli.path, metavar="DIR", help="also check these certificates (transport.tls)")
    replay = "only make this update of a learner again, which was refused, and say what goes wrong in it first"
    parser.add_argument("--replay-update", type=cli.path, metavar="FILE", help=replay)
    parser.add_argument("--json", action="store_true", help="print the results as JSON")
    return parser


def main(options: argparse.Namespace) -> int:
    """Run all checks and print their results; return 1 where one of them failed."""
    results, console = [], PlainConsole()
    if options.replay_update is not None:
        from zsdist.diagnostics.update import check_update  # what it imports may be what the other checks look for

        checks = iter([check_update(options.replay_update)])
    else:
        checks = suite.run_checks(options.address, options.endpoint, options.tls)
    for result in checks:
        results.append(result)
        if not options.json:
            _print(result, console)
    failed = any(result.status is CheckStatus.FAIL for result in results)
    if options.json:
        print(json.dumps({"ok": not failed, "checks": [result.as_json() for result in results]}, indent=1))
    return 1 if failed else 0


def _print(result: CheckResult, console: PlainConsole) -> None:
    console.say((f"{result.status:4}", COLOURS[result.status]), f" {result.check}: {result.found}")
    if result.advice:
        console.say(f"     {result.advice}")


if __name__ == "__main__":
    cli.execute(main, make_parser())
