"""Every error zsdist raises on purpose, under one root.

A message names the thing, the value found and what is allowed, in one line: the commands print it as it is and
exit with status 2.
"""


class ZsdistError(Exception):
    """Root of all errors that are the caller's or the environment's to mend, never a defect of zsdist."""


class ConfigError(ZsdistError):
    """A configuration file or a `--set` names an unknown key or a value outside what is allowed."""


class SceneError(ZsdistError):
    """A scene file or a scene family is malformed, impossible or unsolvable."""


class DecodeError(ZsdistError):
    """Bytes that are not a message of ours. `reason` is a short word that statistics count by."""

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(f"{reason}: {detail}" if detail else reason)
        self.reason = reason


class ProtocolError(ZsdistError):
    """A local caller broke the push protocol (never raised for what a peer sent)."""


class TransportError(ZsdistError):
    """The hub cannot be reached, or an endpoint cannot be used."""


class WeightsError(ZsdistError):
    """Weights are missing, damaged, or belong to another network or encoder."""


class RunError(ZsdistError):
    """A run cannot start, go on or be resumed; or its books do not balance."""


class DataError(ZsdistError):
    """A data set's folder or file is missing, damaged, or not in the layout that is expected."""


class ImageError(ZsdistError, ValueError):
    """Pictures are not an array of the shape and dtype that a network takes."""
