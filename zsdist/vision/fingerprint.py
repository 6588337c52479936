"""Identity of the vision model that a policy was trained with; checkpoints store it, and loading checks it."""

from dataclasses import asdict, dataclass
from typing import Any, Protocol, Self

from zsdist.errors import WeightsError


class VisionHashes(Protocol):
    """Attributes of a visual-act model that identify its weights."""

    encoder_name: str
    encoder_sha256: str
    weights_sha256: str


@dataclass(frozen=True)
class VisionIdentity:
    """Names and hashes of an encoder and of the head on it, or of a network without an encoder.

    Attributes:
        encoder: name of the encoder.
        encoder_sha256: SHA-256 of the encoder's weights.
        network: name of the network, as in `config.vision.network`.
        weights_sha256: SHA-256 of the network's weights.
    """

    encoder: str
    encoder_sha256: str
    network: str
    weights_sha256: str

    @classmethod
    def of(cls, visual_act: VisionHashes, network: str) -> Self:
        """Return the identity of a loaded visual-act model; `network` is the setting `config.vision.network`."""
        return cls(visual_act.encoder_name, visual_act.encoder_sha256, network, visual_act.weights_sha256)

    @classmethod
    def from_json(cls, fields: Any) -> Self:
        """Return the identity read from a checkpoint; raise `ValueError` if `fields` does not come from `to_json`."""
        if not isinstance(fields, dict) or set(fields) != set(cls.__dataclass_fields__):
            raise ValueError(f"vision is {fields!r}; allowed is an object with {', '.join(cls.__dataclass_fields__)}")
        if not all(isinstance(value, str) for value in fields.values()):
            raise ValueError(f"vision is {fields!r}; allowed are strings only")
        return cls(**fields)

    def to_json(self) -> dict[str, str]:
        """Return the identity as a JSON object."""
        return asdict(self)

    def check(self, policy: str, here: "VisionIdentity") -> str | None:
        """Compare the vision model that a policy was trained with (this identity) with the one loaded here.

        An encoder is the same one under another name, which is that of its folder, if its weights are. Two networks
        without an encoder may differ in `encoder_sha256`, since they are their own encoders.

        Args:
            policy: name of the policy, for messages.
            here: identity of the vision model loaded here, which the policy would use.

        Returns:
            One line for the user if only the weights of the network differ; None if nothing differs.

        Raises:
            WeightsError: the encoder here is another one.
        """
        if self.network == here.network != "head":
            differs = self.encoder != here.encoder
        else:
            differs = self.encoder_sha256 != here.encoder_sha256
        if differs:
            raise WeightsError(
                f"policy {policy} was trained on encoder {self.encoder!r} with weights {self.encoder_sha256[:16]}; "
                f"the one here is {here.encoder!r} with {here.encoder_sha256[:16]}; allowed is the same encoder"
            )
        if (self.network, self.weights_sha256) != (here.network, here.weights_sha256):
            return (
                f"note: policy {policy} was trained with {self.network} {self.weights_sha256[:16]} and now uses "
                f"{here.network} {here.weights_sha256[:16]}, on the same encoder"
            )
        return None
