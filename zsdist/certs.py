"""`python -m zsdist.certs DIR`: makes the certificates of a run that other machines take part in."""

import argparse
import socket
from pathlib import Path

from zsdist.common import cli
from zsdist.roles import permissions
from zsdist.transport import certificates

ALWAYS = ("localhost", "127.0.0.1", "::1")


def main(options: argparse.Namespace) -> int:
    """Makes what is missing in the folder, and says what it made and what goes where."""
    hosts = dict.fromkeys([*ALWAYS, socket.gethostname(), *options.host])
    clients = permissions.client_names(options.actors)
    made = certificates.make(options.folder, permissions.HUB, clients, list(hosts), options.days)
    print(f"made {', '.join(made)}" if made else "nothing was missing", f"in {options.folder}")
    if permissions.HUB in made:
        print(f"the hub's certificate is for {', '.join(hosts)}")
    elif options.host:
        print("the hub's certificate was there and stays; for another --host delete hub.pem and hub.key first")
    print(
        f"keep {certificates.AUTHORITY}.key away from every machine of the run; give each what it needs:\n"
        f"  {certificates.AUTHORITY}.pem everywhere, hub and trusted where the run is launched, actor-N where actors\n"
        f"  drive, monitor where somebody watches; then --set transport.tls={options.folder}"
    )
    return 0


def parser() -> argparse.ArgumentParser:
    """The command's options."""
    options = cli.Parser(prog="zsdist.certs", description="Make an authority and the certificates of a run's roles.")
    options.add_argument("folder", type=Path, metavar="DIR", help="where to; what is there already is left as it is")
    options.add_argument(
        "--host", action="append", default=[], metavar="NAME", help="name or address of the hub's machine; repeatable"
    )
    options.add_argument("--actors", type=cli.count, default=16, metavar="N", help="actors that get a certificate (16)")
    options.add_argument("--days", type=cli.count, default=365, metavar="N", help="how long they are valid (365)")
    return options


if __name__ == "__main__":
    cli.execute(main, parser())
