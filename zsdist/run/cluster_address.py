"""Checks before Ray starts: whether a cluster answers and admits us, and whether Ray can keep temporary files.

Ray itself waits minutes for a cluster that is not there, and prints lines of its own.
"""

import os
import socket
import tempfile
from pathlib import Path

from zsdist.config import Config
from zsdist.errors import RunError
from zsdist.run import ray_token

CONNECT_TIMEOUT_S = 3.0
RAY_PORT, RAY_CLIENT_PORT = 6379, 10001
OWN_FOLDER = ("RAY_TMPDIR", "TMPDIR")  # variables that name the folder for temporary files, as Ray reads them
LONGEST_SOCKET = 107  # bytes in the path of a Unix socket
SOCKET_IN_FOLDER = "/ray/session_2026-01-01_00-00-00_000000_/sockets/plasma_store"  # less its process number
_HTTP_2 = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes([0, 0, 0, 4, 0, 0, 0, 0, 0])  # beginning of a gRPC connection
_SETTINGS_AT, _SETTINGS = 3, 4  # place and value of the byte that says which frame a server has answered with


def check(config: Config) -> None:
    """Check that Ray can start or connect as a configuration says; do nothing where a run does not use Ray.

    Raises:
        RunError: it cannot.
    """
    if config.placement != "ray":
        return
    if config.run.address is None:
        check_temporary_folder()
    else:
        check_answers(*resolve(named(config.run.address)))
        ray_token.check(*resolve(named(config.run.address)))


def check_temporary_folder() -> None:
    """Check that Ray can keep its sockets in the folder for temporary files.

    Raises:
        RunError: its name is too long, or it cannot be written.
    """
    folder = temporary_folder()
    name = next((name for name in OWN_FOLDER if name in os.environ), "the folder for temporary files")
    allowed = LONGEST_SOCKET - len(SOCKET_IN_FOLDER) - len(str(os.getpid()))
    if (length := len(os.fsencode(folder))) > allowed:
        raise RunError(
            f"{name} is {folder}, which has {length} bytes; allowed are {allowed}, so that the paths of Ray's sockets "
            "are not too long; set RAY_TMPDIR=/tmp, or use --single-process"
        )
    if not str(folder).isascii() or not folder.is_absolute():
        raise RunError(
            f"{name} is {str(folder)!r}; Ray allows an absolute path of ASCII characters: set RAY_TMPDIR=/tmp, or use "
            "--single-process"
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise RunError(
            f"{name} is {folder}, where Ray cannot write; set RAY_TMPDIR to a folder that can be written, or use "
            "--single-process"
        ) from error


def named(address: str) -> str:
    """Return the address that `auto` means: RAY_ADDRESS, else that of the cluster started last on this machine.

    Any other address is returned unchanged. Ray itself would take any cluster that it finds among the processes of the
    machine, also the private one of another run.

    Raises:
        RunError: there is no cluster that `auto` can mean.
    """
    if address != "auto":
        return address
    target = os.environ.get("RAY_ADDRESS", "")
    if target in ("", "auto"):
        note = temporary_folder() / "ray" / "ray_current_cluster"  # `ray start` writes it
        target = note.read_text(encoding="utf-8").strip() if note.is_file() else ""
    if not target:
        raise RunError(
            "Ray cluster 'auto': none was started on this machine; start one (ray start --head), or name HOST:PORT"
        )
    return target


def temporary_folder() -> Path:
    """Return the folder in which Ray makes its own."""
    return Path(next((os.environ[name] for name in OWN_FOLDER if name in os.environ), "/tmp"))


def resolve(address: str) -> tuple[str, int]:
    """Return host and port of a Ray address, `HOST[:PORT]` or `ray://HOST[:PORT]`.

    Raises:
        RunError: it is not of these forms.
    """
    default = RAY_CLIENT_PORT if address.startswith("ray://") else RAY_PORT
    host, colon, digits = address.removeprefix("ray://").rpartition(":")
    if not colon or digits.endswith("]"):
        host, digits = f"{host}{colon}{digits}", str(default)
    if not host or not digits.isdecimal() or not 0 < int(digits) < 2**16:
        raise RunError(f"Ray cluster {address!r} is not an address; allowed are auto and HOST:PORT")
    return host.strip("[]"), int(digits)


def check_answers(host: str, port: int) -> None:
    """Check that a Ray cluster answers at a port.

    Raises:
        RunError: nobody listens there, or it is not Ray.
    """
    shown = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
    remedy = "check that the head node runs (ray start --head), and that this machine may reach the port"
    try:
        with socket.create_connection((host, port), timeout=CONNECT_TIMEOUT_S) as connection:
            if os.environ.get("RAY_USE_TLS", "0") != "0":
                return  # it answers to those with a certificate only
            connection.settimeout(CONNECT_TIMEOUT_S)
            connection.sendall(_HTTP_2)
            answer = connection.recv(_SETTINGS_AT + 1, socket.MSG_WAITALL)
    except (OSError, UnicodeError) as error:
        raise RunError(f"Ray cluster {shown} does not answer: {error}; {remedy}") from error
    if answer[_SETTINGS_AT:] != bytes([_SETTINGS]):
        raise RunError(f"Ray cluster {shown}: what listens there is not Ray; {remedy}")
