"""Policies by the names that a command line gives them: baselines, shipped policies, run directories, checkpoints."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import zsdist
from zsdist import config
from zsdist.errors import RunError, WeightsError
from zsdist.evaluation.baselines import BASELINES
from zsdist.evaluation.contenders import FULL, VARIANTS, Contender
from zsdist.run.checkpoint import check_vision, load_policy

SHIPPED = {"pretrained": Path(zsdist.__file__).parent / "policies" / "pretrained"}  # learned policies of the package


@dataclass(frozen=True)
class NamedPolicy:
    """A policy that can be evaluated.

    Attributes:
        name: as it was given.
        contender: what drives.
        weights_sha256: hash of its networks; None for a baseline.
        note: line for the user about the vision model it was trained with; None where there is nothing to report.
    """

    name: str
    contender: Contender
    weights_sha256: str | None = None
    note: str | None = None


def find_policy(name: str, config_file: Path | None = None, variant: str = FULL) -> NamedPolicy:
    """Return the policy of a name.

    Args:
        name: of a baseline or a shipped policy, or a path of a run directory or a checkpoint.
        config_file: world of a baseline; a learned policy has its own.
        variant: of a learned policy.

    Raises:
        WeightsError: it is neither a baseline nor a folder with weights, or was trained with another encoder than the
            one on this machine.
        ConfigError: the configuration file is wrong.
        RunError: an option does not fit the policy.
    """
    if variant not in VARIANTS:
        raise RunError(f"--variant is {variant!r}; allowed are {', '.join(VARIANTS)}")
    if name in BASELINES:
        if variant != FULL:
            raise RunError(f"--variant {variant}: baseline {name!r} has no variants; allowed is a learned policy")
        return NamedPolicy(name, Contender(config.load(config_file), baseline=name))
    if config_file is not None:
        raise RunError(f"--config {config_file}: a learned policy has its own configuration; remove the option")
    folder = SHIPPED.get(name, Path(name))
    if not folder.exists():
        known = ", ".join((*SHIPPED, *BASELINES))
        raise WeightsError(f"policy {name!r} is no folder; allowed are a run directory, a checkpoint and {known}")
    policy = load_policy(folder)
    note = check_vision(policy)
    return NamedPolicy(name, Contender(policy.config, policy.parameters, variant=variant), policy.sha256, note)


def check_together(policies: Sequence[NamedPolicy], no_shield: bool) -> None:
    """Check that policies can be evaluated as training seeds of one method, before the first of them drives.

    Args:
        policies: in the order given.
        no_shield: whether each also drives without the shield.

    Raises:
        RunError: they cannot.
    """
    for index, policy in enumerate(policies):
        if no_shield and policy.contender.baseline:
            raise RunError(f"--no-shield: baseline {policy.name!r} has no shield; allowed is a learned policy")
        if policy.contender.baseline and len(policies) > 1:
            raise RunError(
                f"several policies are training seeds of one method; baseline {policy.name!r} is allowed alone"
            )
        for other in policies[:index]:
            if other.weights_sha256 == policy.weights_sha256:
                raise RunError(
                    f"{policy.name} has the weights of {other.name}; allowed are policies of different training seeds"
                )
