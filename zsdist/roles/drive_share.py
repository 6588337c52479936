"""Bound on the part of an actor's time that validation drives take from training."""


class DriveShare:
    """Share of the actions of an actor that go to validation drives while there are episodes to train on.

    The actions are counted from the beginning of each merge. At no time more than this share of the cars is on such
    drives, or one car where that is less than one.

    Args:
        share: the largest share, above 0 and at most 1.
        cars: number of cars of the actor.
    """

    def __init__(self, share: float, cars: int) -> None:
        self._share, self._most_cars = share, max(1, int(share * cars))
        self.begin_merge()

    def begin_merge(self) -> None:
        """Count from here on."""
        self._trained = self._drove = 0

    def count(self, *, trains: bool) -> None:
        """Count an action of a training episode or of a validation drive."""
        if trains:
            self._trained += 1
        else:
            self._drove += 1

    def allows(self, driving: int) -> bool:
        """Return whether one more car may begin a validation drive while `driving` cars are on some."""
        return driving < self._most_cars and self._drove <= self._share * (self._drove + self._trained)
