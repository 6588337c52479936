"""Token that a Ray cluster asks for: whether there is one here, and whether it is the right one.

Ray itself tries for half a minute and says then that the cluster cannot be reached. An explicit address is enough for
it to use no token, whatever lies in the home folder.
"""

import os
import re
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from zsdist.errors import RunError

if TYPE_CHECKING:
    import grpc

MODE, TOKEN, TOKEN_PATH = "RAY_AUTH_MODE", "RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH"
ANSWER_WITHIN_S = 3.0
_PLAIN = (("grpc.enable_http_proxy", 0),)
_CHECK_ALIVE = "/ray.rpc.NodeInfoGcsService/CheckAlive"  # its answer has the version of Ray
_VERSION = re.compile(rb"\x12.(\d+\.\d+[0-9A-Za-z.+-]*)", re.DOTALL)


class Token(NamedTuple):
    """Token, and the place where it was found."""

    text: str
    place: str


def find() -> Token | None:
    """Return the token of this machine, from the first of the places where Ray looks; None where there is none."""
    if text := os.environ.get(TOKEN, "").strip():
        return Token(text, TOKEN)
    given = os.environ.get(TOKEN_PATH)  # the last place, also where nothing is there
    text = _read(Path(given) if given else _home_file())
    return Token(text, f"{TOKEN_PATH} ({given})" if given else str(_home_file())) if text else None


def check(host: str, port: int) -> None:
    """Check that a cluster accepts the token of this machine, and let Ray use it where the cluster asks for one.

    Raises:
        RunError: there is none, it is another one, the cluster wants none and RAY_AUTH_MODE asks for one, or it runs
            another version of Ray.
    """
    if os.environ.get("RAY_USE_TLS", "0") != "0" or os.environ.get("RAY_ENABLE_K8S_TOKEN_AUTH", "0") not in ("", "0"):
        return  # it answers to those with a certificate, or to those with a token of Kubernetes
    import grpc  # a run on one machine does not need it

    shown, mode = f"[{host}]:{port}" if ":" in host else f"{host}:{port}", os.environ.get(MODE, "").lower()
    with grpc.insecure_channel(f"ipv6:{shown}" if ":" in host else shown, _PLAIN) as channel:
        asks, answer = _ask(channel, None)
        if asks:
            answer = _ask_with_token(channel, shown, mode)
        elif answer is not None and mode == "token":
            raise RunError(
                f"Ray cluster {shown} asks for no token, and {MODE} is 'token' here; unset it, or start all nodes with "
                "it (docs/security.md)"
            )
    found, own = _VERSION.search(answer or b""), version("ray")
    if found and (theirs := found[1].decode("ascii", "replace")) != own:
        raise RunError(f"Ray cluster {shown} runs Ray {theirs}, and here is Ray {own}; allowed is the same version")


def _ask_with_token(channel: "grpc.Channel", shown: str, mode: str) -> bytes | None:
    """Return the cluster's answer to one with the token of this machine, and let Ray use it."""
    remedy = "copy that of the head node (docs/security.md)"
    if mode not in ("", "token"):
        raise RunError(
            f"Ray cluster {shown} asks for a token, and {MODE} is {mode!r} here; set it to token, and {remedy}"
        )
    token = find()
    if token is None:
        path = os.environ.get(TOKEN_PATH)
        places = f"{TOKEN}, {TOKEN_PATH} ({path})" if path else f"{TOKEN}, {TOKEN_PATH}, {_home_file()}"
        raise RunError(f"Ray cluster {shown} asks for a token, and there is none in {places}; {remedy}")
    refused, answer = _ask(channel, token.text)
    if refused:
        raise RunError(f"Ray cluster {shown} refuses the token in {token.place}: it is of another cluster; {remedy}")
    os.environ[MODE] = "token"  # for Ray in this process, which is imported afterwards
    return answer


def _ask(channel: "grpc.Channel", token: str | None) -> tuple[bool, bytes | None]:
    """Return whether a cluster refuses a question for lack of the right token, and its answer where it gave one."""
    import grpc

    metadata = [("authorization", f"Bearer {token}")] if token else None
    try:
        return False, channel.unary_unary(_CHECK_ALIVE)(b"", timeout=ANSWER_WITHIN_S, metadata=metadata)
    except grpc.RpcError as error:
        return error.code() is grpc.StatusCode.UNAUTHENTICATED, None


def _home_file() -> Path:
    return Path(os.path.expanduser("~")) / ".ray" / "auth_token"


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8").strip()
    except (OSError, UnicodeDecodeError):
        return ""
