"""Kinds of options that the commands of robots share."""

import argparse
import math
from collections.abc import Callable

from zsdist.ros2 import keys


def number(least: float, most: float, allowed: str) -> Callable[[str], float]:
    """Return the type of an option that is a number within a range.

    Args:
        least: least number.
        most: greatest number.
        allowed: words for the range.
    """

    def parsed(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not least <= value <= most:  # NaN fails
            raise argparse.ArgumentTypeError(f"value is {text!r}; allowed is {allowed}")
        return value

    return parsed


positive = number(1e-3, 1e6, "a number of 0.001 or more")
natural = number(0.0, 1e6, "a number of 0 or more")
share = number(0.0, 1.0, "a number from 0 to 1")
metres = number(-1e6, 1e6, "a number of metres")


def topic(text: str) -> str:
    """Return the value of an option that is the name of a topic, with its leading slash."""
    try:
        return keys.absolute_topic(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from error


def domain(text: str) -> int:
    """Return the value of an option that is a domain of ROS 2."""
    value = int(text) if text.isascii() and text.isdecimal() else -1
    if not 0 <= value <= keys.MOST_DOMAIN:
        raise argparse.ArgumentTypeError(f"domain is {text!r}; allowed is 0 to {keys.MOST_DOMAIN}")
    return value
