"""Merges of whole runs on a virtual clock: neither cars nor learners wait for them."""

from flow import NoPictures, NoScenes
from guest_run import GuestRun, SlowCar

from zsdist.roles.actor import Actor
from zsdist.roles.learner import Learner
from zsdist.roles.scheduler.progress import Stage

CARS, SHARE, EPISODES, EVERY = 4, 0.5, 60, 20


class MergingRun(GuestRun):
    """Run of one actor with slow cars."""

    def __init__(self, folder):
        level = {"min_size": 8, "updates_per_insert": 1.0, "hidden": [4]}
        super().__init__(
            folder,
            (),
            run={"cars_per_actor": CARS, "episodes": EPISODES},
            merge={"every_episodes": EVERY, "validation_scenes": 10, "distil_updates": 1, "share": SHARE},
            high=level,
            low=level,
        )
        context = self._context("actor", "0", 1)
        self.actor = Actor(context, [SlowCar() for _ in range(CARS)], NoPictures(), NoScenes())
        self.add(self.actor)
        self.learners = [role for role in self._roles if isinstance(role, Learner)]

    def counts(self):
        """Return the number of training actions, of actions of candidates, and of updates."""
        trained, updates = self.actor.env_steps, sum(learner.updates for learner in self.learners)
        return trained, self.actor.actions - trained, updates


def test_cars_collect_and_learners_update_during_merges_which_take_no_more_than_their_share(tmp_path):
    run, begun = MergingRun(tmp_path / "journal"), {}
    while run.stage is Stage.TRAIN:
        run.step()
        merge = run.scheduler.progress.merge
        if merge is not None:
            then = begun.setdefault(merge.index, run.counts())
        if merge is not None and run.scheduler.finished_episodes < EPISODES:
            trained, drove, updates = (now - before for now, before in zip(run.counts(), then, strict=True))
            assert drove <= SHARE * (trained + drove) + 2 * CARS * SlowCar.actions
            if drove > 100:
                assert trained > drove / 2 and updates > trained / SlowCar.actions, "something waits for the merge"
    assert begun.keys() == {1, 2, 3}
    summary = run.finish()
    assert [merge["episode"] for merge in summary["merges"]] == [EVERY, 2 * EVERY, EPISODES]
    for merge in summary["merges"]:
        assert merge["cost"]["drives"] == sum(merge["scenes_driven"].values()) and merge["cost"]["seconds"] > 0
