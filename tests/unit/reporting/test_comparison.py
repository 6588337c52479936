from made_runs import RESULT

from zsdist.reporting import comparison
from zsdist.reporting.runs import Evaluation


def test_every_policy_and_every_kind_of_scenes_is_in_the_figure(tmp_path):
    drove = [
        Evaluation(RESULT | {"scenes": scenes, "success": rate}, label)
        for scenes, label, rate in (("iid", "full", 0.9), ("iid", "astar", 1.0), ("ood-all", "full", 0.5))
    ]
    assert comparison.draw_policies(drove, tmp_path) == "policies.png"
    drawing = (tmp_path / "policies.svg").read_text()
    assert all(f">{words}<" in drawing for words in ("full", "astar", "iid", "ood-all", "success", "collision"))
