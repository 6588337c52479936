"""To which hub of a tree the process of a role connects."""

import pytest

from zsdist.config import parse
from zsdist.errors import RunError
from zsdist.run.program import RoleSpec
from zsdist.run.role_host import RoleHost

ROOT, ONE, TWO = "tls/h:1", "tls/a:1", "tls/b:1"


class Connections:
    """Specification of a run whose connections are noted and fail."""

    def __init__(self, folder):
        self.config, self.folder, self.made = (
            parse({"cluster": {"hubs": [f"{ONE}@rack=a", f"{TWO}@rack=b"]}}),
            folder,
            [],
        )

    def connect(self, role_spec, endpoint, others=()):
        self.made.append((endpoint, *others))
        raise RunError("that is all")


class OnNode(RoleHost):
    def __init__(self, spec, **labels):
        super().__init__(spec)
        self._labels = labels

    def labels(self):
        return self._labels


@pytest.mark.parametrize(
    ("role", "labels", "expected"),
    [
        ("actor", {"rack": "a", "zone": "x"}, (ONE, ROOT)),
        ("actor", {"rack": "b"}, (TWO, ROOT)),
        ("actor", {"rack": "c"}, (ROOT,)),
        ("actor", {}, (ROOT,)),
        ("learner", {"rack": "a"}, (ROOT,)),
    ],
)
def test_an_actor_uses_the_hub_of_its_rack_and_the_run_s_own_while_that_is_away(tmp_path, role, labels, expected):
    spec = Connections(tmp_path)
    assert OnNode(spec, **labels).drive(RoleSpec(role, "0", 1), ROOT) == f"{role}-0: that is all"
    assert spec.made == [expected]
