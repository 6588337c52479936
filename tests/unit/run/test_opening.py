import json

import pytest

from zsdist import config
from zsdist.errors import RunError
from zsdist.run import directory, opening
from zsdist.vision.fingerprint import VisionIdentity
from zsdist.wire.messages import State


@pytest.mark.parametrize(("ended", "wanted"), [("complete", 3), ("interrupted", 2), (None, 2)])
def test_a_run_is_resumed_unless_its_episodes_and_what_follows_them_are_complete(tmp_path, monkeypatch, ended, wanted):
    folder = directory.create(tmp_path / "run", config.Config())
    vision = VisionIdentity("clip/b", "a" * 64, "head", "b" * 64)
    state = State("scheduler", {"finished": [1, 2], "wall_s": 0.0}, {})
    directory.RunDirectory(folder, vision).checkpoint(2, {"scheduler": state})
    if ended:
        (folder / "summary.json").write_text(json.dumps({"ended": ended}))
    monkeypatch.setattr(opening.preflight, "check_shards", lambda settings, states: None)
    monkeypatch.setattr(opening, "check_parts", lambda settings, notify: vision)

    def resumed_episodes(episodes):
        overrides = (f"run.episodes={episodes}",)
        return opening.open_resumed(folder, overrides, lambda line: None).config.run.episodes

    with pytest.raises(RunError, match="has finished 2 episodes"):
        resumed_episodes(wanted - 1)
    assert resumed_episodes(wanted) == wanted
