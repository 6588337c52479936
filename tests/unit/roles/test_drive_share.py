import numpy as np
import pytest

from zsdist.roles.drive_share import DriveShare

DRIVE, EPISODE = 150, 70  # actions


def drive(share, cars, actions, rng):
    """Let cars act that always find something to do; return the share of actions in drives, and the most cars."""
    bound, left, trains = DriveShare(share, cars), [0] * cars, [True] * cars
    drove = most = 0
    for _ in range(actions):
        for car in range(cars):
            if left[car] == 0:
                others = sum(left[other] > 0 and not trains[other] for other in range(cars))
                trains[car] = not bound.allows(others)
                left[car] = int(rng.integers(1, EPISODE if trains[car] else DRIVE))
            bound.count(trains=trains[car])
            left[car] -= 1
            drove += not trains[car]
        most = max(most, sum(left[car] > 0 and not trains[car] for car in range(cars)))
    return drove / (cars * actions), most


@pytest.mark.parametrize("share", [0.1, 0.25, 0.5, 0.8])
@pytest.mark.parametrize("cars", [1, 2, 4, 9])
def test_drives_take_their_share_of_the_time_and_no_more(share, cars):
    found, most = drive(share, cars, 8000, np.random.default_rng(0))
    assert found <= share + DRIVE / 8000
    assert most <= max(1, share * cars)
    assert found > 0.7 * min(share, max(1, int(share * cars)) / cars)


def test_with_the_whole_share_every_car_may_drive():
    assert drive(1.0, 3, 1000, np.random.default_rng(0)) == (1.0, 3)


def test_each_merge_begins_with_a_drive():
    bound = DriveShare(0.25, 4)
    bound.count(trains=False)
    assert not bound.allows(0)
    bound.begin_merge()
    assert bound.allows(0) and not bound.allows(1)
