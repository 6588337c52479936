"""Networks that a learner goes on with after a merge: those of the winner, with what was learned meanwhile."""

from collections.abc import Mapping

from zsdist.roles.schemas import BEST, RECENT, CandidateName
from zsdist.types import Parameters


def promoted(chosen: CandidateName, candidates: Mapping[CandidateName, Parameters], present: Parameters) -> Parameters:
    """Return the network of the winner, changed as training has changed the recent one since the candidates were made.

    With the recent network as the winner this is the present one. The best network so far wins against all that was
    learned since, which is therefore dropped. The distilled network is the recent one after some steps towards the
    guide, so what was learned meanwhile is added to it; exactly the network that was compared results if that is
    nothing.

    Args:
        chosen: name of the winner.
        candidates: all candidates of the merge.
        present: present online network.
    """
    winner, snapshot = candidates[chosen], candidates[RECENT]
    if chosen == RECENT:
        return present
    if chosen == BEST:
        return winner
    return {name: winner[name] + (present[name] - snapshot[name]) for name in winner}
