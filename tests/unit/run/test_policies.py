import pytest

from zsdist.errors import WeightsError
from zsdist.run.policies import load_by_name


def test_every_command_says_that_a_shipped_policy_is_meant_and_not_the_folder_of_its_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pretrained").mkdir()
    said = []
    shipped = load_by_name("pretrained", (), notify=said.append)
    assert said == ["note: policy 'pretrained' is the built-in one; for the one in this folder write ./pretrained"]
    assert len(shipped.sha256) == 64
    with pytest.raises(WeightsError):
        load_by_name("./pretrained", (), notify=said.append)  # that folder is empty
    assert len(said) == 1
