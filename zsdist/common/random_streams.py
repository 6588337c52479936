"""Random streams: the table of the numbers that seed each generator.

A generator is seeded by a list of numbers: the tag of its stream, the user's seed, then the subject of the stream (an
episode, a set of pictures). numpy pads such lists with zeros, so `[s]`, `[s, 0]` and `[s, 0, 0]` are one generator, and
it takes a number beyond 32 bits as two. No two streams coincide here, because every list begins with a tag of its own,
the lists of one stream are equally long, and each number takes two places of 32 bits. Scenes alone have no tag: their
lists begin with the number of a family, which is smaller than any tag.

Runs are repeatable only with the same numbers: a changed number changes every result that follows from it.

| stream | tag | subject |
|---|---|---|
| `initial_weights` | 1001 | seed |
| `reflected_rows` | 1002 | seed |
| `replay_sampling` | 1003 | seed, 0 (high) or 1 (low), shard |
| `exploration` | 1004 | seed, episode |
| `shielded_episodes` | 1005 | seed, episode |
| `training_scene` | 1006 | seed, episode |
| `candidate_drive` | 1007 | seed, merge, validation scene |
| `evaluated_episode` | 1008 | seed, index among the scenes |
| `intervals` | 1009 | seed |
| `scene` | none | number of the family, seed of the scene |
| `labelled_pictures` | 1010 | seed, characters of the split's name |
| `masked_pictures` | 1011 | seed, characters of the split's name |
| `captioned_pictures` | 1012 | seed, characters of the split's name |
| `training_stage` | 1013 | seed, number of the stage |
| `check_wilderness` | 1014 | seed |
| `check_goals` | 1015 | seed |
| `check_set` | 1016 | seed, number of the set |
| `check_approach` | 1017 | seed, number of the approach |
| `check_names` | 1018 | seed |
| `check_words` | 1019 | seed |
| `fresh_pictures` | 1020 | seed, characters of the split's name |
| `map_scenes` | 1030 | seed |
| `robot_odometry` | 1040 | seed |
| `robot_camera` | 1041 | seed |
"""

import numpy as np
from numpy.random import Generator

Seed = tuple[int, ...]

_WORD = 2**32  # numpy's generators are seeded by words of 32 bits


def initial_weights(seed: int) -> Generator:
    """Return the stream of a network's initial weights."""
    return _generator(1001, seed)


def reflected_rows(seed: int) -> Generator:
    """Return the stream that chooses which rows of a batch a learner reflects."""
    return _generator(1002, seed)


def replay_sampling(seed: int, high: bool, shard: int) -> Generator:
    """Return the stream that draws the batches of one shard of the high or the low level's replay."""
    return _generator(1003, seed, 0 if high else 1, shard)


def exploration(seed: int, episode: int) -> Seed:
    """Return the seed of one training episode's exploration."""
    return _seed(1004, seed, episode)


def shielded_episodes(seed: int, episode: int) -> Generator:
    """Return the stream that decides whether the shield masks in a training episode."""
    return _generator(1005, seed, episode)


def training_scene(seed: int, episode: int) -> Generator:
    """Return the stream that draws the scene of a training episode."""
    return _generator(1006, seed, episode)


def candidate_drive(seed: int, merge: int, index: int) -> Seed:
    """Return the seed of a candidate's drive through validation scene `index` of a merge."""
    return _seed(1007, seed, merge, index)


def evaluated_episode(seed: int, index: int) -> Generator:
    """Return the stream of the driver in evaluated scene `index`."""
    return _generator(1008, seed, index)


def intervals(seed: int) -> Generator:
    """Return the stream that resamples episodes for bootstrap intervals."""
    return _generator(1009, seed)


def map_scenes(seed: int) -> Generator:
    """Return the stream that draws starts and goals on a map."""
    return _generator(1030, seed)


def robot_odometry(seed: int) -> Generator:
    """Return the stream of the errors of a simulated robot's odometry."""
    return _generator(1040, seed)


def robot_camera(seed: int) -> Generator:
    """Return the stream of the errors of a simulated robot's camera."""
    return _generator(1041, seed)


def scene(family: int, seed: int) -> Generator:
    """Return the stream that draws a scene of a family; `family` is its number in the list of families."""
    return np.random.default_rng([family, seed])


def labelled_pictures(seed: int, split: str) -> Generator:
    """Return the stream of labelled pictures of a split, simulated or photographed."""
    return _generator(1010, seed, *split.encode())


def masked_pictures(seed: int, split: str) -> Generator:
    """Return the stream of a split's masked pictures."""
    return _generator(1011, seed, *split.encode())


def captioned_pictures(seed: int, split: str) -> Generator:
    """Return the stream of a split's captioned pictures."""
    return _generator(1012, seed, *split.encode())


def training_stage(seed: int, stage: int) -> Generator:
    """Return the stream of one stage of a pretraining."""
    return _generator(1013, seed, stage)


def check_wilderness(seed: int) -> Generator:
    """Return the stream of the wilderness pictures of a check."""
    return _generator(1014, seed)


def check_goals(seed: int) -> Generator:
    """Return the stream of the goals for which a check reads its pictures."""
    return _generator(1015, seed)


def check_set(seed: int, number: int) -> Generator:
    """Return the stream of the pictures of one set of a check."""
    return _generator(1016, seed, number)


def check_approach(seed: int, number: int) -> Generator:
    """Return the stream of one approach to an object in a check."""
    return _generator(1017, seed, number)


def check_names(seed: int) -> Generator:
    """Return the stream of the words from which a check chooses the names of pictures."""
    return _generator(1018, seed)


def check_words(seed: int) -> Generator:
    """Return the stream of the words on which a check trains projections that have not seen some kinds."""
    return _generator(1019, seed)


def fresh_pictures(seed: int, split: str) -> Generator:
    """Return the stream of a shard of fresh pictures of a split."""
    return _generator(1020, seed, *split.encode())


def _seed(tag: int, *numbers: int) -> Seed:
    """Return the list that seeds a stream: its tag, then each number as two words, the lower one first."""
    return (tag, *(word for number in numbers for word in (number % _WORD, number // _WORD)))


def _generator(tag: int, *numbers: int) -> Generator:
    return np.random.default_rng(_seed(tag, *numbers))
