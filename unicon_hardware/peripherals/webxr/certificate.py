"""Certificate: a self-made one for the page, made once; a headset shows WebXR to no other pages."""

from __future__ import annotations

import datetime
import ipaddress
import os
import socket
import ssl
from contextlib import suppress
from pathlib import Path
from typing import Any

from unicon_base.errors import UniconError, imported
from unicon_base.resources import user_folder

_DAYS = 800


def certificate(host: str) -> Path:
    """Return the file of key and certificate for a host, mode 0600; made where there is none.

    It lies in `$XDG_STATE_HOME/unicon/webxr`. One that has expired, is for another host, or cannot
    be read is made again: the browser asks again then.

    Args:
        host: address where the page is served.

    Raises:
        MissingDependencyError: `cryptography` is not installed.
        UniconError: it cannot be written.
    """
    x509 = imported("cryptography.x509", "webxr over TLS", "webxr")
    folder = user_folder("webxr")
    if folder is None:
        raise UniconError("webxr: no home to keep a certificate in; set XDG_STATE_HOME")
    path = folder / "certificate.pem"
    with suppress(OSError, ValueError, x509.ExtensionNotFound):
        if path.stat().st_mode & 0o077 == 0 and _serves(path, host):
            return path
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        fresh = folder / f"certificate.{os.getpid()}"
        fresh.unlink(missing_ok=True)
        file = os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(file, "wb") as out:
            out.write(_made(host))
        fresh.rename(path)
    except OSError as error:
        raise UniconError(f"webxr: {path}: {error.strerror}; make the folder writable") from error
    return path


def _names(host: str) -> list[Any]:
    from cryptography import x509

    names: list[Any] = [x509.DNSName("localhost"), x509.DNSName(socket.gethostname() or "robot")]
    for address in dict.fromkeys(("127.0.0.1", host)):
        try:
            names.append(x509.IPAddress(ipaddress.ip_address(address)))
        except ValueError:
            names.append(x509.DNSName(address))
    return names


def _serves(path: Path, host: str) -> bool:
    from cryptography import x509

    found = x509.load_pem_x509_certificate(path.read_bytes())
    names = found.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    until = found.not_valid_after_utc - datetime.timedelta(days=1)
    now = datetime.datetime.now(datetime.timezone.utc)
    return now < until and set(_names(host)) <= set(names)


def _made(host: str) -> bytes:
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec

    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, "unicon webxr")])
    now = datetime.datetime.now(datetime.timezone.utc)
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - datetime.timedelta(days=1))
        .not_valid_after(now + datetime.timedelta(days=_DAYS))
        .add_extension(x509.SubjectAlternativeName(_names(host)), critical=False)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .sign(key, hashes.SHA256())
    )
    secret = key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )
    return bytes(secret + made.public_bytes(serialization.Encoding.PEM))


def fingerprint(path: Path) -> str:
    """Return a certificate's SHA-256 as browsers show it."""
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes

    found = x509.load_pem_x509_certificate(path.read_bytes())
    return bytes(found.fingerprint(hashes.SHA256())).hex(":")


def secured(path: Path) -> ssl.SSLContext:
    """Return the server's TLS with a certificate."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(path)
    return context
