"""Errors that zsdist raises on purpose, under one root.

A message names in one line what is wrong, the value found and what is allowed. The commands print it unchanged and exit
with status 2.
"""


class ZsdistError(Exception):
    """Root of all errors that the caller or the environment has to correct; never a defect of zsdist."""


class ConfigError(ZsdistError):
    """Unknown key or value that is not allowed, in a configuration file, a `--set` or another option."""


class SceneError(ZsdistError):
    """Scene file or scene family that is malformed, impossible or unsolvable."""


class SimulationError(ZsdistError):
    """Simulation that cannot be started, since its process has too many."""


class DecodeError(ZsdistError):
    """Received bytes that are not a valid message.

    Attributes:
        reason: short word by which statistics count the error.
    """

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(f"{reason}: {detail}" if detail else reason)
        self.reason = reason


class ProtocolError(ZsdistError):
    """Violation of the push protocol by a local caller; never raised for what a peer sent."""


class TransportError(ZsdistError):
    """Hub that cannot be reached, or endpoint, certificate or key that cannot be used."""


class WeightsError(ZsdistError):
    """Weights that are missing, damaged, or belong to another network or encoder."""


class CacheError(WeightsError):
    """Folder of caches that is not known, or cannot be written or read."""


class RunError(ZsdistError):
    """Run or stored result that cannot be started, resumed, read or written, or whose counts do not agree."""


class CompleteError(RunError):
    """Run that is to be resumed and has nothing left to do."""


class DamagedError(RunError):
    """File of a run that is missing, or whose content is not what was written."""


class BundleError(ZsdistError):
    """Bundle that is missing, damaged or of another version, or that a picture, a pose or a goal does not fit."""


class DataError(ZsdistError):
    """Folder or file of a data set that is missing, damaged, or not in the expected layout."""


class ImageError(ZsdistError, ValueError):
    """Pictures that are not an array of the shape and dtype that a network expects."""
