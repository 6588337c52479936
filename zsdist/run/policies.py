"""Learned policies by name: those that the package ships, run directories and checkpoints."""

from collections.abc import Iterable
from pathlib import Path

import zsdist
from zsdist.common import places
from zsdist.config import Notify
from zsdist.errors import WeightsError
from zsdist.run.checkpoint import Policy, load_policy
from zsdist.run.checkpoint_writer import names_best

SHIPPED = {"pretrained": Path(zsdist.__file__).parent / "policies" / "pretrained"}


def load_by_name(
    name: str, other_names: Iterable[str], overrides: tuple[str, ...] = (), notify: Notify | None = None
) -> Policy:
    """Return the policy that a name stands for.

    Args:
        name: name of a shipped policy, or path of a run directory or a checkpoint.
        other_names: further allowed names, for the error.
        overrides: settings to change, as `KEY.PATH=VALUE`.
        notify: called with lines for the user.

    Raises:
        WeightsError: it is neither, or its weights are missing or damaged.
    """
    if notify is not None and (line := places.find_clash("policy", name, SHIPPED)):
        notify(line)
    try:
        folder = SHIPPED[name] if name in SHIPPED else places.expand(name)
    except ValueError as error:
        raise WeightsError(f"policy {name!r}: {error}") from error
    if not folder.exists() and not names_best(folder):
        known = ", ".join((*SHIPPED, *other_names))
        raise WeightsError(f"policy {name!r} is no folder; allowed are a run directory, a checkpoint and {known}")
    return load_policy(folder, overrides, notify)
