"""What is withheld from whom: families, kinds, grounds and seeds for each purpose, in one place.

The vision model is trained on streets and never sees a tree, a sand pile or a rock, nor sand; the policy is trained
in scattered scenes and never meets a sand pile, a rock, a box or a car, nor sand; validation uses what policy
training uses, with seeds of its own; the test families have all of it. `singleton` alone has no split: its ten scenes
are trained on and tested on, which is what it is for (Fig. 1 of the paper).

Words are learned from scenes of their own, which show every kind and ground: one cannot learn what a rock is called
without having seen one. Only the projection to text space is trained on them; the visual-act head, which is tested on
kinds and grounds it has not seen, never is.
"""

from dataclasses import dataclass
from typing import Literal

from zsdist.errors import SceneError
from zsdist.sim.scenes.kinds import GROUNDS, KINDS

Split = Literal["train", "validation", "test", "vision"]

_SPLIT_SIZE = 1_000_000
SPLITS: dict[str, range] = {
    split: range(i * _SPLIT_SIZE, (i + 1) * _SPLIT_SIZE)
    for i, split in enumerate(("train", "validation", "test", "vision"))
}

OOD_FAMILIES = (
    "ood-start-goal",
    "ood-layout",
    "ood-clusters",
    "ood-density",
    "ood-appearance",
    "ood-dynamic",
    "ood-all",
)
POLICY_KINDS = ("tree", "bush", "pole", "person")
STREET_KINDS = ("box", "car", "pole", "person")
WITHHELD_KINDS = ("sand_pile", "rock")  # from the training of head and policy
WITHHELD_GROUNDS = ("sand",)
TRAINED_GROUNDS = tuple(ground for ground in GROUNDS if ground not in WITHHELD_GROUNDS)


@dataclass(frozen=True)
class Purpose:
    """What scenes drawn for one purpose may contain.

    Attributes:
        families: from which they may come.
        kinds: of obstacles in them.
        grounds: in them.
        split: whose seeds they have (a key of `SPLITS`).
    """

    families: tuple[str, ...]
    kinds: tuple[str, ...]
    grounds: tuple[str, ...]
    split: Split


MANIFEST: dict[str, Purpose] = {
    "vision-training": Purpose(("street", "varied"), (*STREET_KINDS, "bush"), TRAINED_GROUNDS, "vision"),
    "word-training": Purpose(("vocabulary",), tuple(KINDS), tuple(GROUNDS), "vision"),
    "policy-training": Purpose(("singleton", "iid"), POLICY_KINDS, TRAINED_GROUNDS, "train"),
    "validation": Purpose(("singleton", "iid"), POLICY_KINDS, TRAINED_GROUNDS, "validation"),
    "test": Purpose(("iid", *OOD_FAMILIES), tuple(KINDS), tuple(GROUNDS), "test"),
}


def split_seed(split: Split, index: int) -> int:
    """The seed of the `index`-th scene of a split; those of different splits never meet.

    Raises:
        SceneError: an unknown split, or more scenes than a split has.
    """
    if split not in SPLITS:
        raise SceneError(f"split is {split!r}; allowed are {', '.join(SPLITS)}")
    if not 0 <= index < _SPLIT_SIZE:
        raise SceneError(f"index of a scene is {index}; allowed is 0 to {_SPLIT_SIZE - 1}")
    return SPLITS[split][index]
