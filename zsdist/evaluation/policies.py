"""Policies as a command line names them, and the check that several can be evaluated together."""

from collections.abc import Sequence
from dataclasses import dataclass

from zsdist.errors import RunError
from zsdist.evaluation.contenders import Contender


@dataclass(frozen=True)
class NamedPolicy:
    """Policy that can be evaluated, with the name by which it was given.

    Attributes:
        name: name as it was given.
        contender: contender that drives.
        weights_sha256: hash of its networks; None for a baseline.
        note: line for the user about the vision model it was trained with; None where there is nothing to report.
    """

    name: str
    contender: Contender
    weights_sha256: str | None = None
    note: str | None = None


def check_together(policies: Sequence[NamedPolicy], no_shield: bool) -> None:
    """Check that policies can be evaluated as training seeds of one method, before the first of them drives.

    Args:
        policies: policies in the order given.
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
