"""`python -m zsdist.certs DIR`: make the certificates of a run on several machines."""

import argparse
import socket

from zsdist.common import cli, commands
from zsdist.common.console import say
from zsdist.roles import permissions
from zsdist.transport import certificates

LOCAL_HOSTS = ("localhost", "127.0.0.1", "::1")


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command's options."""
    parser = cli.Parser(prog="zsdist.certs", description="Make an authority and the certificates of a run's roles.")
    add = parser.add_argument
    add("folder", type=cli.path, metavar="DIR", help="folder of the certificates; existing files stay as they are")
    host = "name or address of the hub's machine; repeatable"
    add("--host", action="append", default=[], metavar="NAME", help=host)
    add("--actors", type=cli.count, default=16, metavar="N", help="number of actors that get a certificate (16)")
    add("--days", type=cli.count, default=365, metavar="N", help="days for which the certificates are valid (365)")
    return parser


def main(options: argparse.Namespace) -> int:
    """Make the files that are missing in the folder; print what was made and which machine needs which file."""
    hosts = dict.fromkeys([*LOCAL_HOSTS, socket.gethostname(), *options.host])
    clients = permissions.client_names(options.actors)
    made = certificates.make(options.folder, permissions.HUB, clients, list(hosts), options.days)
    joined = ", ".join(made)
    say(f"{f'made {joined}' if made else 'nothing was missing'} in {options.folder}")
    if permissions.HUB in made:
        say(f"the hub's certificate is for {', '.join(hosts)}")
    elif options.host:
        say("the hub's certificate existed and was not changed; for another --host delete hub.pem and hub.key first")
    authority = certificates.AUTHORITY
    say(f"keep {authority}.key away from every machine of the run. Launch with this option, after copying these files:")
    say(f"  {commands.quoted('--set', f'transport.tls={options.folder.absolute()}')}")
    say(f"  every machine                       {authority}.pem")
    say(f"  the machine that launches the run   {permissions.HUB}.* and {permissions.TRUSTED}.*")
    say(f"  machines where learners live        {permissions.learner_name('*')} (by default that one too)")
    say(f"  machines where replay shards live   {permissions.REPLAY}.* (by default that one too)")
    say("  machines that run actors            actor-N.*")
    say(f"  machines that watch the run         {permissions.MONITOR}.*")
    return 0


if __name__ == "__main__":
    cli.execute(main, make_parser())
