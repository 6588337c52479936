import os

import pytest
from ray_head import ray_head

from zsdist.errors import RunError
from zsdist.run import ray_token

RIGHT, OTHER = "a" * 64, "b" * 64


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    """An empty home folder and no word about tokens in the environment, put back afterwards."""
    monkeypatch.setenv("HOME", str(tmp_path))
    for name in ("RAY_AUTH_MODE", "RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH", "RAY_USE_TLS", "RAY_ENABLE_K8S_TOKEN_AUTH"):
        monkeypatch.setenv(name, "")  # so that it is put back, whatever is done to it
        monkeypatch.delenv(name)
    return tmp_path


def put(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def test_the_token_is_taken_from_the_first_of_three_places(home, monkeypatch):
    assert ray_token.find() is None
    file = put(home / ".ray" / "auth_token", f"{RIGHT}\n")
    assert ray_token.find() == (RIGHT, str(file))
    monkeypatch.setenv("RAY_AUTH_TOKEN_PATH", str(home / "missing"))
    assert ray_token.find() is None
    monkeypatch.setenv("RAY_AUTH_TOKEN_PATH", str(put(home / "given", OTHER)))
    assert ray_token.find() == (OTHER, f"RAY_AUTH_TOKEN_PATH ({home / 'given'})")
    monkeypatch.setenv("RAY_AUTH_TOKEN", RIGHT)
    assert ray_token.find() == (RIGHT, "RAY_AUTH_TOKEN")


def refusal(token=None, **head):
    with ray_head(token, **head) as port, pytest.raises(RunError) as refused:
        ray_token.check("127.0.0.1", port)
    assert "\n" not in str(refused.value) and f"127.0.0.1:{port}" in str(refused.value)
    return str(refused.value)


def test_a_missing_token_is_named_with_all_places_where_it_was_looked_for(home):
    text = refusal(RIGHT)
    assert "asks for a token, and there is none in RAY_AUTH_TOKEN, RAY_AUTH_TOKEN_PATH, " in text
    assert str(home / ".ray" / "auth_token") in text and "docs/security.md" in text


def test_a_wrong_token_is_refused_with_the_place_that_has_it_and_is_not_shown(home):
    text = refusal_with_file(home, OTHER)
    assert f"refuses the token in {home / '.ray' / 'auth_token'}" in text and OTHER not in text


def refusal_with_file(home, text):
    put(home / ".ray" / "auth_token", text)
    return refusal(RIGHT)


def test_the_right_token_is_used_without_a_word_of_the_user(home):
    put(home / ".ray" / "auth_token", RIGHT)
    with ray_head(RIGHT) as port:
        ray_token.check("127.0.0.1", port)
    assert os.environ["RAY_AUTH_MODE"] == "token"


def test_a_token_that_is_switched_off_here_is_named(home, monkeypatch):
    monkeypatch.setenv("RAY_AUTH_MODE", "disabled")
    assert "RAY_AUTH_MODE is 'disabled' here" in refusal_with_file(home, RIGHT)


def test_a_cluster_without_a_token_gets_none(home, monkeypatch):
    put(home / ".ray" / "auth_token", RIGHT)
    with ray_head() as port:
        ray_token.check("127.0.0.1", port)
    assert "RAY_AUTH_MODE" not in os.environ
    monkeypatch.setenv("RAY_AUTH_MODE", "token")
    assert "asks for no token" in refusal()


def test_another_version_of_ray_is_named():
    assert "runs Ray 2.9.1, and here is Ray" in refusal(ray_version="2.9.1")


def test_who_does_not_answer_is_left_to_other_checks(home):
    with ray_head() as port:
        pass
    ray_token.check("127.0.0.1", port)
