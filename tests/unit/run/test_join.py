"""Names that actors may have which join a run; whole parties are in tests/integration/test_join.py."""

import pytest

from zsdist.errors import TransportError
from zsdist.roles import permissions
from zsdist.run.join import actor_names
from zsdist.transport import certificates


def test_without_certificates_every_name_may_be_used():
    names = actor_names(None, 3)
    assert names[:2] == ["actor-0", "actor-1"] and len(names) == permissions.MAX_ACTORS


def test_with_certificates_only_names_that_have_one_may_be_used_in_the_order_of_their_numbers(tmp_path):
    names = ["actor-10", "actor-9", "actor-x", "stranger", "monitor"]
    certificates.make(tmp_path, permissions.HUB, names, ["127.0.0.1"], days=1)
    assert actor_names(tmp_path, 2) == ["actor-9", "actor-10"]
    with pytest.raises(TransportError, match=r"has certificates of 2 actors and --actors is 3; make more"):
        actor_names(tmp_path, 3)


def test_a_certificate_without_its_key_is_named(tmp_path):
    certificates.make(tmp_path, permissions.HUB, ["actor-9"], ["127.0.0.1"], days=1)
    (tmp_path / "actor-9.key").unlink()
    with pytest.raises(TransportError, match=r"actor-9\.key"):
        actor_names(tmp_path, 1)
