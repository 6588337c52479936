"""Families, kinds, grounds and seeds of the scenes for each purpose.

* The vision model is trained on streets and never sees a tree, a sand pile, a rock or sand.
* The policy is trained in scattered scenes and never meets a sand pile, a rock, a box, a car or sand.
* Validation uses the kinds and grounds of policy training, with seeds of its own.
* The test families have all kinds and grounds.
* `singleton` has no split: training and test use the same ten scenes, as in Fig. 1 of the paper.
* Words are learned from scenes of their own, which show every kind and ground, since the word for a rock cannot be
  learned without a picture of one. Only the projection to text space is trained on them, never the visual-act head,
  which is tested on kinds and grounds that it has not seen.
"""

from dataclasses import dataclass
from typing import Literal

from zsdist.errors import SceneError
from zsdist.sim.scenes.kinds import GROUNDS, KINDS

Split = Literal["train", "validation", "test", "vision"]

SPLIT_SCENES = 1_000_000  # number of scenes of a family in each split
SPLITS: dict[str, range] = {
    split: range(i * SPLIT_SCENES, (i + 1) * SPLIT_SCENES)
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
WITHHELD_KINDS = ("sand_pile", "rock")  # withheld from the training of head and policy
WITHHELD_GROUNDS = ("sand",)
TRAINED_GROUNDS = tuple(ground for ground in GROUNDS if ground not in WITHHELD_GROUNDS)


@dataclass(frozen=True)
class Purpose:
    """Contents that scenes for one purpose may have.

    Attributes:
        families: families of the scenes.
        kinds: allowed kinds of obstacles.
        grounds: allowed kinds of ground.
        split: split from which the seeds are taken (a key of `SPLITS`).
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
    """Return the seed of the `index`-th scene of a split; splits share no seeds.

    Raises:
        SceneError: the split is unknown, or the index is out of range.
    """
    if split not in SPLITS:
        raise SceneError(f"split is {split!r}; allowed are {', '.join(SPLITS)}")
    if not 0 <= index < SPLIT_SCENES:
        raise SceneError(f"index of a scene in a split is {index}; allowed is 0 to {SPLIT_SCENES - 1}")
    return SPLITS[split][index]


def wrapped(number: int, stride: int) -> int:
    """Return the index in a split that stands for a number without an upper limit.

    Numbers below `SPLIT_SCENES` are their own indices. Later ones go through the split again, each time `stride`
    further on. So numbers that come in groups of up to `stride`, with gaps between the groups, first fill the gaps.
    """
    return (number + number // SPLIT_SCENES * stride) % SPLIT_SCENES
