"""Drive one episode with the policy that comes with the package, and print each decision.

Usage: `python examples/drive_episode.py [FAMILY] [INDEX]`, by default `ood-layout 0`. `python -m zsdist.evaluate`
does the same for many scenes, with intervals and films.
"""

import sys

import numpy as np

from zsdist.evaluate import find_policy
from zsdist.evaluation.episodes import Moment
from zsdist.evaluation.records import EpisodeRecord
from zsdist.evaluation.workers import make_runner
from zsdist.sim.scenes import families
from zsdist.types import Action


def show(moment: Moment) -> None:
    """Print the pose of the car and the chosen action."""
    pose = moment.observed.pose
    if moment.action is not None:
        print(f"x {pose.x_m:+6.2f} m, y {pose.y_m:+6.2f} m: {Action(moment.action).name.lower()}")


def main(family: str = "ood-layout", index: str = "0") -> EpisodeRecord:
    """Drive test scene `index` of `family` greedily and return the episode."""
    contender = find_policy("pretrained").contender
    runner = make_runner(contender)
    scene = families.draw(family, "test", int(index))
    record = runner.drive(scene, np.random.default_rng(0), show)
    print(f"{record.scene}: {record.outcome.value} after {record.steps} actions and {record.path_m:.1f} m")
    return record


if __name__ == "__main__":
    main(*sys.argv[1:])
