"""Settings of where the roles of a run live on a cluster. A run on one machine does not use them.

Hub and scheduler live on the machine that launches: the one has its address, the other its run directory.
"""

import re
from typing import Annotated, Literal, NamedTuple, Self

from pydantic import Field, field_validator, model_validator

from zsdist.common.section import Section

LAUNCHER, OTHERS, ANY = "launcher", "others", "any"  # the machine that launches, all but that one, all
_LABEL = re.compile(r"[A-Za-z0-9]([A-Za-z0-9._/-]*[A-Za-z0-9])?")


def labels_of(text: str) -> dict[str, str]:
    """Return labels of a node by name, from `NAME=VALUE,NAME=VALUE` as `ray start --labels` takes them.

    Raises:
        ValueError: the text has another form.
    """
    labels = {}
    for item in filter(None, map(str.strip, text.split(","))):
        name, _, value = item.partition("=")
        if not _LABEL.fullmatch(name) or not _LABEL.fullmatch(value):
            raise ValueError("allowed is NAME=VALUE, or several of them with commas between, as ray start --labels")
        labels[name] = value
    return labels


class RolePlace(Section):
    """Machines on which the processes of one kind of role live, and what each of them reserves there."""

    node: Literal["launcher", "others", "any"] = "launcher"  # the launching machine, all but that one, or all
    labels: str = ""  # labels that a node must have, as `ray start --labels` takes them: NAME=VALUE,NAME=VALUE
    cpus: Annotated[float, Field(ge=0)] | None = None  # cores of Ray that each reserves; None: run.cpus_per_role
    gpus: Annotated[float, Field(ge=0, le=64)] = 0.0  # GPUs of Ray that each reserves; below 1 several roles share one
    memory_bytes: Annotated[int, Field(ge=0)] = 0  # memory of Ray that each reserves

    @field_validator("labels")
    @classmethod
    def _readable(cls, text: str) -> str:
        labels_of(text)
        return text

    @model_validator(mode="after")
    def _possible(self) -> Self:
        if self.labels and self.node == LAUNCHER:
            raise ValueError(
                f"labels are {self.labels!r} and node is {self.node!r}; with labels allowed is node 'others' or 'any'"
            )
        return self


class ActorPlace(RolePlace):
    """Place of actors, which may live on any machine unless told otherwise."""

    node: Literal["launcher", "others", "any"] = "any"


class Branch(NamedTuple):
    """Hub of a rack or a site, to which the actors there connect, and which is a branch of the run's own hub.

    Attributes:
        endpoint: endpoint at which it listens, an address of its node.
        labels: labels of its node and of the nodes whose actors use it.
    """

    endpoint: str
    labels: dict[str, str]

    @classmethod
    def of(cls, text: str) -> "Branch":
        """Return the branch of a text `ENDPOINT@LABELS`, such as `tls/10.0.1.1:7447@rack=a`.

        Raises:
            ValueError: the text has another form.
        """
        endpoint, _, labels = text.partition("@")
        if not re.fullmatch(r"tls/.+:[0-9]+", endpoint) or not labels_of(labels):
            raise ValueError(f"{text!r} is no hub; allowed is ENDPOINT@LABELS, such as tls/10.0.1.1:7447@zsdist/rack=a")
        return cls(endpoint, labels_of(labels))


class ClusterConfig(Section):
    """Places of roles on a cluster."""

    hubs: tuple[Annotated[str, Field(min_length=1)], ...] = ()  # one more for each rack or site: ENDPOINT@LABELS
    learner: RolePlace = RolePlace()
    replay: RolePlace = RolePlace()  # of every shard
    actor: ActorPlace = ActorPlace()

    @field_validator("hubs")
    @classmethod
    def _hubs(cls, texts: tuple[str, ...]) -> tuple[str, ...]:
        for text in texts:
            Branch.of(text)
        return texts

    @property
    def branches(self) -> list[Branch]:
        """Hubs of `hubs`, in their order."""
        return [Branch.of(text) for text in self.hubs]
