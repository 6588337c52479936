"""Errors that zsdist raises on purpose, under one root.

A message names in one line what is wrong, the value found and what is allowed. The commands print it unchanged and exit
with status 2.
"""


class ZsdistError(Exception):
    """Root of all errors that the caller or the environment has to correct; never a defect of zsdist."""


class ConfigError(ZsdistError):
    """A configuration file or a `--set` names an unknown key or a value outside what is allowed."""


class SceneError(ZsdistError):
    """A scene file or a scene family is malformed, impossible or unsolvable."""


class DecodeError(ZsdistError):
    """Received bytes are not a valid message.

    Attributes:
        reason: short word by which statistics count the error.
    """

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(f"{reason}: {detail}" if detail else reason)
        self.reason = reason


class ProtocolError(ZsdistError):
    """A local caller violated the push protocol; never raised for what a peer sent."""


class TransportError(ZsdistError):
    """The hub cannot be reached, or an endpoint cannot be used."""


class WeightsError(ZsdistError):
    """Weights are missing, damaged, or belong to another network or encoder."""


class RunError(ZsdistError):
    """A run cannot be started, continued or resumed, or its counts of transitions do not agree."""


class DataError(ZsdistError):
    """A folder or file of a data set is missing, damaged, or not in the expected layout."""


class ImageError(ZsdistError, ValueError):
    """Pictures are not an array of the shape and dtype that a network expects."""
