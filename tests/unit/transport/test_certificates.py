"""Checks of a folder of certificates before a process uses it."""

import stat

import pytest

from zsdist.errors import TransportError
from zsdist.transport import certificates
from zsdist.transport.certificates import Identity

HOSTS = ["127.0.0.1", "hub.example"]


@pytest.fixture
def folder(tmp_path):
    assert certificates.make(tmp_path / "made", "hub", ["a", "b"], HOSTS, days=40) == ["ca", "hub", "a", "b"]
    return tmp_path / "made"


def test_each_name_has_a_sound_identity_and_only_the_servers_is_for_hosts(folder):
    for name in ("hub", "a", "b"):
        identity = Identity.load(folder, name)
        assert identity.days_left() == 39
        assert identity.hosts() == (HOSTS if name == "hub" else [])


def test_only_their_owner_may_read_keys_and_folder(folder):
    assert stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert {stat.S_IMODE(path.stat().st_mode) for path in folder.glob("*.key")} == {0o600}


def test_existing_certificates_stay_and_missing_ones_are_made(folder):
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    assert certificates.make(folder, "hub", ["a", "b", "c"], ["other"], days=1) == ["c"]
    assert {path.name: path.read_bytes() for path in folder.iterdir() if path.stem != "c"} == before
    Identity.load(folder, "c")


def swap(folder, name, other, suffix):
    (folder / f"{name}{suffix}").write_bytes((folder / f"{other}{suffix}").read_bytes())


@pytest.mark.parametrize(
    ("spoil", "telling"),
    [
        (lambda folder: (folder / "a.pem").unlink(), "a.pem: No such file"),
        (lambda folder: (folder / "a.key").unlink(), "a.key: No such file"),
        (lambda folder: (folder / "ca.pem").write_text("nonsense"), "ca.pem is not a certificate"),
        (lambda folder: (folder / "a.key").write_text("nonsense"), "a.key is not a private key"),
        (lambda folder: swap(folder, "a", "b", ".key"), "does not belong to certificate"),
        (lambda folder: swap(folder, "a", "b", ".pem"), "is for 'b'; allowed is 'a'"),
    ],
)
def test_an_identity_whose_files_do_not_fit_is_refused_by_name(folder, spoil, telling):
    spoil(folder)
    with pytest.raises(TransportError) as refused:
        Identity.load(folder, "a")
    assert telling in str(refused.value) and "\n" not in str(refused.value)


def test_a_certificate_of_another_authority_is_refused(folder, tmp_path):
    certificates.make(tmp_path / "other", "hub", ["a"], HOSTS, days=1)
    for file in ("a.pem", "a.key"):
        (folder / file).write_bytes((tmp_path / "other" / file).read_bytes())
    with pytest.raises(TransportError, match="is not signed by the authority"):
        Identity.load(folder, "a")


def test_a_certificate_out_of_date_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(certificates, "CLOCK_DIFFERENCE", certificates.datetime.timedelta(days=9))
    certificates.make(tmp_path, "hub", ["a"], HOSTS, days=-1)
    with pytest.raises(TransportError, match="but not now"):
        Identity.load(tmp_path, "a")


def test_a_folder_that_cannot_be_written_and_a_host_that_is_none_are_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(TransportError, match="file"):
        certificates.make(tmp_path / "file" / "in", "hub", [], HOSTS, days=1)
    with pytest.raises(TransportError, match="host is 'häuptling'"):
        certificates.make(tmp_path / "new", "hub", [], ["häuptling"], days=1)
