"""Policies read from run directories and checkpoints."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

from zsdist import config
from zsdist.config import Config
from zsdist.dqn import network
from zsdist.errors import ConfigError, RunError, WeightsError
from zsdist.run import checkpoint_files, checkpoint_writer, location, program
from zsdist.types import Level, Parameters
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.wire.messages import State


@dataclass(frozen=True)
class Policy:
    """Both levels' networks and the configuration that they were trained with.

    Attributes:
        config: configuration of the run that trained it.
        parameters: online networks by level.
        sha256: hash of both networks together, 64 hex digits.
        source: path that it was read from.
        vision: vision model that it was trained with; None: it is untrained.
    """

    config: Config
    parameters: dict[Level, Parameters]
    sha256: str
    source: str
    vision: VisionIdentity | None = None


def load_policy(path: Path, overrides: tuple[str, ...] = (), notify: config.Notify | None = None) -> Policy:
    """Return the policy of a run directory (its newest whole checkpoint) or of one checkpoint folder.

    `checkpoints/best` in a run directory stands for the networks that won the merge with the highest score, which are
    in the best checkpoint beside those that learned on since.

    Args:
        path: either of them, or a path inside it, or `checkpoints/best`.
        overrides: settings to change, as `KEY.PATH=VALUE`.
        notify: called with lines for the user.

    Raises:
        WeightsError: it has no weights, or they are damaged.
    """
    best = checkpoint_writer.names_best(path)
    try:
        checkpoint = checkpoint_writer.require_best(path.parents[1]) if best else location.find_checkpoint(path)
        if checkpoint is None:
            checkpoint, states, _ = checkpoint_files.newest_whole(location.find_run(path), notify)
        else:
            states = checkpoint_files.read_checkpoint(checkpoint)
        vision = checkpoint_files.read_vision(checkpoint)
        settings = config.load_kept(checkpoint.absolute().parent.parent / "config.yaml", overrides, notify)
    except ConfigError as error:
        raise WeightsError(f"policy {path}: {error}") from error
    except RunError as error:
        raise WeightsError(f"policy {path} has no weights to drive with: {error}") from error
    missing = [level for level in Level if f"learner-{level}" not in states]
    if missing:
        raise WeightsError(f"policy {path}: checkpoint {checkpoint} lacks the {missing[0]} level's network")
    return policy_of(settings, states, str(checkpoint), vision, "best/" if best else "dqn/online/")


def check_vision(policy: Policy) -> str | None:
    """Compare the vision model that a policy was trained with to the one that it would use here.

    Returns:
        One line for the user where the head or the student differs on the same encoder, else None.

    Raises:
        WeightsError: the encoder differs, or vision weights are missing or damaged.
    """
    if policy.vision is None:
        return None
    return policy.vision.check(policy.source, program.vision_here(policy.config))


def policy_of(
    settings: Config, states: dict[str, State], source: str, vision: VisionIdentity, part: str = "dqn/online/"
) -> Policy:
    """Return the policy in the states of a checkpoint, made of a part of the learners' states."""
    parameters = {level: states[f"learner-{level}"].part(part) for level in Level}
    return make_policy(settings, parameters, source, vision)


def make_policy(
    settings: Config, parameters: dict[Level, Parameters], source: str, vision: VisionIdentity | None = None
) -> Policy:
    """Return a policy of given networks."""
    digest = hashlib.sha256("".join(network.sha256(parameters[level]) for level in Level).encode()).hexdigest()
    return Policy(settings, parameters, digest, source, vision)
