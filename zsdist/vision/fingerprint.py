"""By what a policy sees: kept in every checkpoint, and held against what is there when it is to drive."""

from dataclasses import asdict, dataclass
from typing import Any, Protocol, Self

from zsdist.errors import WeightsError


class VisionHashes(Protocol):
    """What a visual-act model says of its weights."""

    encoder_name: str
    encoder_sha256: str
    weights_sha256: str


@dataclass(frozen=True)
class VisionIdentity:
    """The encoder and the network on it.

    Attributes:
        encoder: its name.
        encoder_sha256: of its weights.
        network: "head" or "student".
        weights_sha256: of head or student.
    """

    encoder: str
    encoder_sha256: str
    network: str
    weights_sha256: str

    @classmethod
    def of(cls, visual_act: VisionHashes, network: str) -> Self:
        """Of a model that is loaded as `config.vision.network` says."""
        return cls(visual_act.encoder_name, visual_act.encoder_sha256, network, visual_act.weights_sha256)

    @classmethod
    def from_json(cls, fields: Any) -> Self:
        """From a checkpoint; raises `ValueError` where it is not what `to_json` returns."""
        if not isinstance(fields, dict) or set(fields) != set(cls.__dataclass_fields__):
            raise ValueError(f"vision is {fields!r}; allowed is an object with {', '.join(cls.__dataclass_fields__)}")
        if not all(isinstance(value, str) for value in fields.values()):
            raise ValueError(f"vision is {fields!r}; allowed are words only")
        return cls(**fields)

    def to_json(self) -> dict[str, str]:
        """As a JSON object."""
        return asdict(self)

    def check(self, policy: str, here: "VisionIdentity") -> str | None:
        """Holds what a policy was trained with (this) against what is here.

        A student is told by its name alone: it has no encoder besides its own weights.

        Args:
            policy: how messages call it.
            here: what it would see by.

        Returns:
            One line for the user where another head or student is on the same encoder, else None.

        Raises:
            WeightsError: the encoder here is another.
        """
        alone = self.network == here.network == "student"
        if self.encoder != here.encoder or (self.encoder_sha256 != here.encoder_sha256 and not alone):
            raise WeightsError(
                f"policy {policy} was trained on encoder {self.encoder!r} with weights {self.encoder_sha256[:16]}; "
                f"the one here is {here.encoder!r} with {here.encoder_sha256[:16]}, and allowed is the same"
            )
        if (self.network, self.weights_sha256) != (here.network, here.weights_sha256):
            return (
                f"note: policy {policy} was trained with {self.network} {self.weights_sha256[:16]} and sees by "
                f"{here.network} {here.weights_sha256[:16]} now, on the same encoder"
            )
        return None
