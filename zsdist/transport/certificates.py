"""Certificates of a hub and its clients, signed by one authority.

A folder holds `ca.pem` and `ca.key`, and for each common name NAME the files `NAME.pem` and `NAME.key`. A client proves
with its key that it owns the certificate. The common name determines the client's rights at the hub (`access`).
"""

import datetime
import errno
import ipaddress
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.types import (
    CertificateIssuerPrivateKeyTypes,
    CertificateIssuerPublicKeyTypes,
    PrivateKeyTypes,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from zsdist.common import commands, folders
from zsdist.errors import TransportError

AUTHORITY = "ca"
MOST_DAYS = 36_500
CLOCK_DIFFERENCE = datetime.timedelta(minutes=10)  # between machines: certificates are backdated by it
_HASH = hashes.SHA256()
_SERVER, _CLIENT = ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH


@dataclass(frozen=True)
class Identity:
    """Identity of a process: its common name, and the paths of its certificate, its key and the authority it trusts."""

    name: str
    authority: Path
    certificate: Path
    key: Path

    @classmethod
    def load(cls, folder: str | Path, name: str) -> "Identity":
        """Return the identity `name` from a folder of certificates, checked.

        Raises:
            TransportError: a file is missing, unreadable or out of date, or the files do not belong together.
        """
        folder = Path(folder)
        if folder.is_dir() and not (folder / f"{name}.pem").exists():
            raise TransportError(
                f"certificate {folder / f'{name}.pem'}: {os.strerror(errno.ENOENT)}; copy it from where the folder was "
                f"made, or make what it lacks there: {commands.module('zsdist.certs', folder)}"
            )
        identity = cls(name, folder / f"{AUTHORITY}.pem", folder / f"{name}.pem", folder / f"{name}.key")
        authority, certificate = _read(identity.authority), _read(identity.certificate)
        try:
            certificate.verify_directly_issued_by(authority)
        except (InvalidSignature, ValueError, TypeError) as error:
            raise TransportError(
                f"certificate {identity.certificate} is not signed by the authority in {identity.authority}"
            ) from error
        if common_name(certificate) != name:
            raise TransportError(
                f"certificate {identity.certificate} is for {common_name(certificate)!r}; allowed is {name!r}"
            )
        for path, found in ((identity.authority, authority), (identity.certificate, certificate)):
            now = datetime.datetime.now(datetime.UTC)
            if not found.not_valid_before_utc <= now <= found.not_valid_after_utc:
                valid = f"{found.not_valid_before_utc:%Y-%m-%d} to {found.not_valid_after_utc:%Y-%m-%d}"
                raise TransportError(f"certificate {path} is valid from {valid}, but not now")
        if _read_key(identity.key).public_key() != certificate.public_key():
            raise TransportError(f"key {identity.key} does not belong to certificate {identity.certificate}")
        return identity

    def days_left(self) -> int:
        """Return the number of days until the certificate or the authority's certificate expires."""
        ends = min(_read(path).not_valid_after_utc for path in (self.authority, self.certificate))
        return (ends - datetime.datetime.now(datetime.UTC)).days

    def hosts(self) -> list[str]:
        """Return the names and addresses for which the certificate of a server is valid; none for a client."""
        try:
            named = _read(self.certificate).extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        except x509.ExtensionNotFound:
            return []
        return [str(name.value) for name in named]


def make(folder: Path, server: str, clients: Iterable[str], hosts: Sequence[str], days: int) -> list[str]:
    """Make the certificates that a folder lacks: those of the authority, the server and each client.

    Args:
        folder: folder of the certificates; only its owner may read it.
        server: common name of the process that accepts connections; it may connect too.
        clients: common names of processes that may only connect.
        hosts: names and addresses under which the server is reached.
        days: validity in days, at most `MOST_DAYS`.

    Returns:
        The names of the certificates made; existing ones are left unchanged.

    Raises:
        TransportError: `days` is too long, the folder cannot be written, or its authority cannot be used.
    """
    if days > MOST_DAYS:
        raise TransportError(f"validity of certificates is {days} days; allowed are at most {MOST_DAYS}")
    made = []
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if not (folder / f"{AUTHORITY}.pem").exists():
            key = ec.generate_private_key(ec.SECP256R1())
            _write(folder, AUTHORITY, _builder(AUTHORITY, AUTHORITY, key, days, authority=True).sign(key, _HASH), key)
            made.append(AUTHORITY)
        authority = _read(folder / f"{AUTHORITY}.pem")
        # this cast only excludes keys that cannot sign, which `make` never writes for an authority
        authority_key = cast(CertificateIssuerPrivateKeyTypes, _read_key(folder / f"{AUTHORITY}.key"))
        for name in (server, *clients):
            if not (folder / f"{name}.pem").exists():
                key = ec.generate_private_key(ec.SECP256R1())
                builder = _builder(name, common_name(authority), key, days)
                for extension in _purposes(authority, hosts if name == server else ()):
                    builder = builder.add_extension(extension, critical=False)
                _write(folder, name, builder.sign(authority_key, _HASH), key)
                made.append(name)
    except OSError as error:
        raise TransportError(f"certificates in {folder}: {error.filename}: {error.strerror}") from error
    return made


def names(folder: str | Path) -> list[str]:
    """Return the common names that a folder has certificates of, in alphabetical order; the authority's is not one."""
    return sorted(path.stem for path in folders.visible(Path(folder), "*.pem") if path.stem != AUTHORITY)


def common_name(certificate: x509.Certificate) -> str:
    """Return the common name in a certificate; empty if it has none."""
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if names else ""


def _builder(
    name: str, issuer: str, key: ec.EllipticCurvePrivateKey, days: int, *, authority: bool = False
) -> x509.CertificateBuilder:
    """Return the builder of a certificate, still without its purposes."""
    now = datetime.datetime.now(datetime.UTC)
    subject, signer = (x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, text)]) for text in (name, issuer))
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(signer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - CLOCK_DIFFERENCE)
        .not_valid_after(now + datetime.timedelta(days=days))
        .add_extension(x509.BasicConstraints(ca=authority, path_length=0 if authority else None), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )


def _purposes(authority: x509.Certificate, hosts: Sequence[str]) -> list[x509.ExtensionType]:
    """Return the extensions for a certificate's purposes: to connect, and with hosts also to accept connections."""
    authority_key = cast(CertificateIssuerPublicKeyTypes, authority.public_key())  # it signed its own certificate
    signer = x509.AuthorityKeyIdentifier.from_issuer_public_key(authority_key)
    if not hosts:
        return [signer, x509.ExtendedKeyUsage([_CLIENT])]
    return [signer, x509.ExtendedKeyUsage([_SERVER, _CLIENT]), x509.SubjectAlternativeName(list(map(_host, hosts)))]


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        pass
    try:
        return x509.DNSName(host)
    except ValueError as error:
        raise TransportError(f"host is {host!r}; allowed is an IP address or a host name in ASCII") from error


def _write(folder: Path, name: str, certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey) -> None:
    """Write key and certificate. The key comes first, readable by its owner only, so no certificate lacks its key."""
    private = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    descriptor = os.open(folder / f"{name}.key", os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
    with os.fdopen(descriptor, "wb") as file:
        file.write(private)
    (folder / f"{name}.pem").write_bytes(certificate.public_bytes(serialization.Encoding.PEM))


def _read(path: Path) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except OSError as error:
        raise TransportError(f"certificate {path}: {error.strerror}") from error
    except ValueError as error:
        raise TransportError(f"{path} is not a certificate in PEM format") from error


def _read_key(path: Path) -> PrivateKeyTypes:
    try:
        return serialization.load_pem_private_key(path.read_bytes(), password=None)
    except OSError as error:
        raise TransportError(f"key {path}: {error.strerror}") from error
    except (ValueError, TypeError) as error:
        raise TransportError(f"{path} is not a private key in PEM format without a password") from error
