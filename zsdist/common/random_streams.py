"""Random streams: the table of the numbers that seed each generator.

A generator is seeded by a list: the user's seed, then numbers for the subject of the stream (an episode, a set of
pictures), then a tag that keeps streams of the same subject apart. numpy pads such lists with zeros, so `[s]`,
`[s, 0]` and `[s, 0, 0]` are one stream.

Runs are repeatable only with the same numbers: a changed number changes every result that follows from it.

| stream | seeded by |
|---|---|
| `initial_weights` | seed |
| `reflected_rows` | seed, 1 |
| `replay_sampling` | seed, 0 (high) or 1 (low), shard |
| `exploration` | seed, episode |
| `shielded_episodes` | seed, episode, 1 |
| `training_scene` | seed, episode, 2 |
| `candidate_drive` | seed, merge, validation scene |
| `evaluated_episode` | seed, index among the scenes |
| `intervals` | seed |
| `scene` | number of the family, seed of the scene |
| `labelled_pictures` | seed, characters of the split's name |
| `masked_or_captioned_pictures` | seed, 4, characters of the split's name |
| `training_stage` | seed, number of the stage |
| `check_wilderness` | seed, 2 |
| `check_goals` | seed, 3 |
| `check_set` | seed, 4, number of the set |
| `check_approach` | seed, 5, number of the approach |
| `check_names` | seed, 6 |
| `check_words` | seed, 7 |
"""

import numpy as np
from numpy.random import Generator

Seed = tuple[int, ...]


def initial_weights(seed: int) -> Generator:
    """Return the stream of a network's initial weights."""
    return np.random.default_rng(seed)


def reflected_rows(seed: int) -> Generator:
    """Return the stream that chooses which rows of a batch a learner reflects."""
    return np.random.default_rng([seed, 1])


def replay_sampling(seed: int, high: bool, shard: int) -> Generator:
    """Return the stream that draws the batches of one shard of the high or the low level's replay."""
    return np.random.default_rng([seed, 0 if high else 1, shard])


def exploration(seed: int, episode: int) -> Seed:
    """Return the seed of one training episode's exploration."""
    return (seed, episode)


def shielded_episodes(seed: int, episode: int) -> Generator:
    """Return the stream that decides whether the shield masks in a training episode."""
    return np.random.default_rng([seed, episode, 1])


def training_scene(seed: int, episode: int) -> Generator:
    """Return the stream that draws the scene of a training episode."""
    return np.random.default_rng([seed, episode, 2])


def candidate_drive(seed: int, merge: int, index: int) -> Seed:
    """Return the seed of a candidate's drive through validation scene `index` of a merge."""
    return (seed, merge, index)


def evaluated_episode(seed: int, index: int) -> Generator:
    """Return the stream of the driver in evaluated scene `index`."""
    return np.random.default_rng([seed, index])


def intervals(seed: int) -> Generator:
    """Return the stream that resamples episodes for bootstrap intervals."""
    return np.random.default_rng(seed)


def scene(family: int, seed: int) -> Generator:
    """Return the stream that draws a scene of a family; `family` is its number in the list of families."""
    return np.random.default_rng([family, seed])


def labelled_pictures(seed: int, split: str) -> Generator:
    """Return the stream of labelled pictures of a split, simulated or photographed."""
    return np.random.default_rng([seed, *split.encode()])


def masked_or_captioned_pictures(seed: int, split: str) -> Generator:
    """Return the stream of a split's masked pictures, or of its captioned ones."""
    return np.random.default_rng([seed, 4, *split.encode()])


def training_stage(seed: int, stage: int) -> Generator:
    """Return the stream of one stage of a pretraining."""
    return np.random.default_rng([seed, stage])


def check_wilderness(seed: int) -> Generator:
    """Return the stream of the wilderness pictures of a check."""
    return np.random.default_rng([seed, 2])


def check_goals(seed: int) -> Generator:
    """Return the stream of the goals for which a check reads its pictures."""
    return np.random.default_rng([seed, 3])


def check_set(seed: int, number: int) -> Generator:
    """Return the stream of the pictures of one set of a check."""
    return np.random.default_rng([seed, 4, number])


def check_approach(seed: int, number: int) -> Generator:
    """Return the stream of one approach to an object in a check."""
    return np.random.default_rng([seed, 5, number])


def check_names(seed: int) -> Generator:
    """Return the stream of the words from which a check chooses the names of pictures."""
    return np.random.default_rng([seed, 6])


def check_words(seed: int) -> Generator:
    """Return the stream of the words on which a check trains projections that have not seen some kinds."""
    return np.random.default_rng([seed, 7])
