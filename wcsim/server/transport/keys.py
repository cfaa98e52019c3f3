"""Keys for clients on other machines: which may join a world, and proof of identity of both ends.

A folder of keys has `server.secret`, `server.public`, and for each client that may join
`clients/NAME.public` and `clients/NAME.secret`. A client's machine needs `server.public` and the
client's secret. The files are those of zmq.auth.
"""

import contextlib
import logging
import os
import re
import shutil
import tempfile
import time
from collections.abc import Sequence
from ipaddress import ip_address
from pathlib import Path
from typing import Final, NamedTuple

import zmq
import zmq.auth
from zmq.auth.thread import ThreadAuthenticator

from wcsim.errors import ConfigError

log = logging.getLogger("wcsim.server.transport.keys")

LOOK_S: Final = 1.0
_CLIENTS: Final = "clients"
_KEY_LENGTH: Final = 40  # characters
_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")
_ADDRESS: Final = re.compile(r"tcp://(?P<host>\[[0-9A-Fa-f:.]+\]|[^:/\[\]]+):(?P<port>\d{1,5}|\*)")


class _KeyPair(NamedTuple):
    """One party's keys, in ZeroMQ's text form."""

    public: bytes
    secret: bytes


def create_missing_keys(folder: Path, names: Sequence[str]) -> tuple[str, ...]:
    """Make the missing keys of the server and of these clients; returns the new clients.

    Raises:
        ConfigError: A name is not allowed, or the folder cannot be written.
    """
    for name in names:
        if not _NAME.fullmatch(name):
            raise ConfigError(
                f"client name {name!r}: expected letters, digits, - and _, 64 at most"
            )
    try:
        (folder / _CLIENTS).mkdir(mode=0o700, parents=True, exist_ok=True)
        folder.chmod(0o700)
        if not (folder / "server.secret").exists():
            _make_pair(folder, "server")
        new = tuple(name for name in names if not (folder / _CLIENTS / f"{name}.public").exists())
        for name in new:
            _make_pair(folder / _CLIENTS, name)
    except OSError as error:
        raise ConfigError(
            f"{folder}: keys cannot be written ({error.strerror}); choose another folder"
        ) from None
    return new


def read_server_keys(folder: Path) -> _KeyPair:
    """The server's own keys. Raises ConfigError when they are missing, or others can read them."""
    return _load_pair(folder / "server.secret")


def read_client_keys(folder: Path, name: str) -> _KeyPair:
    """The keys of a client of this name, or of the only one in the folder. Raises ConfigError."""
    own = folder / _CLIENTS / f"{name}.secret"
    if _NAME.fullmatch(name) and own.exists():
        return _load_pair(own)
    secrets = sorted((folder / _CLIENTS).glob("*.secret"))
    if len(secrets) != 1:
        raise ConfigError(
            f"{own}: not found, but {len(secrets)} other secret keys; "
            "expected this one, or a single one"
        )
    return _load_pair(secrets[0])


def list_known_clients(folder: Path) -> tuple[str, ...]:
    """The clients whose public keys are in a folder, sorted."""
    return tuple(sorted(path.stem for path in (folder / _CLIENTS).glob("*.public")))


def read_server_public_key(folder: Path) -> bytes:
    """The server's public key, which its clients have. Raises ConfigError when it is missing."""
    return _load(folder / "server.public")[0]


def is_loopback(address: str) -> bool:
    """Whether only this machine can reach a TCP address.

    >>> is_loopback("tcp://127.0.0.1:5000"), is_loopback("tcp://0.0.0.0:5000")
    (True, False)

    Raises:
        ConfigError: It is no TCP address.
    """
    match = _ADDRESS.fullmatch(address)
    if match is None or (match["port"] != "*" and int(match["port"]) > 65535):
        raise ConfigError(
            f"address {address!r}: expected tcp://HOST:PORT, such as tcp://127.0.0.1:5555"
        )
    host = match["host"].strip("[]")
    if host == "localhost":
        return True
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return False


class ClientKeyLookup:
    """The clients whose public keys are in a folder, which is read again when it changes.

    A key that was taken out lets no client in. Messages of its open connections are refused.
    """

    def __init__(self, folder: Path) -> None:
        """Read the folder. Raises ConfigError when it has no key, or a file that is no key."""
        self._folder = folder / _CLIENTS
        self._names: dict[str, str] = {}  # by public key, in text form
        self._state: tuple[tuple[str, int], ...] = ()
        self._looked_s = 0.0
        self._read()
        if not self._names:
            raise ConfigError(
                f"{self._folder}: contains no NAME.public of a client; "
                "expected one for each client that may join"
            )

    def guard(self, context: zmq.Context[zmq.Socket[bytes]]) -> ThreadAuthenticator:
        """Start to admit these clients to the sockets of a context; the result is to be stopped."""
        guard = ThreadAuthenticator(context)
        guard.start()
        guard.configure_curve_callback("*", self)
        return guard

    def name(self, key: str) -> str:
        """The client of this key, "" for an unknown key; reads the folder once a second."""
        now_s = time.monotonic()
        if now_s - self._looked_s > LOOK_S:
            self._looked_s = now_s
            with contextlib.suppress(ConfigError, OSError):
                self._read()
        return self._names.get(key, "")

    def callback(self, domain: str, key: bytes) -> bool:
        """Whether a client with this public key (in text form) may connect.

        zmq.auth calls this in a thread of its own.
        """
        del domain
        try:
            self._read()
        except (ConfigError, OSError) as error:
            log.error("no client can join: %s", error)
            return False
        return key.decode("ascii", "replace") in self._names

    def _read(self) -> None:
        files = sorted(path for path in self._folder.glob("*.public") if _NAME.fullmatch(path.stem))
        state = tuple((path.name, path.stat().st_mtime_ns) for path in files)
        if state != self._state:
            self._names = {_load(path)[0].decode("ascii"): path.stem for path in files}
            self._state = state


def _make_pair(folder: Path, name: str) -> None:
    """Write both files of a party; other users can never read the secret one."""
    # Beside the files: within one file system a move is a rename.
    with tempfile.TemporaryDirectory(dir=folder, prefix=".new-") as work:  # noqa: TID251
        public, secret = zmq.auth.create_certificates(work, name)
        Path(secret).chmod(0o600)
        shutil.move(secret, folder / f"{name}.secret")
        shutil.move(public, folder / f"{name}.public")


def _load_pair(path: Path) -> _KeyPair:
    public, secret = _load(path)
    if secret is None:
        raise ConfigError(f"{path}: contains no secret key; expected a file made by --make-keys")
    status = path.stat()
    if status.st_mode & 0o077 or status.st_uid not in (0, os.getuid()):
        raise ConfigError(f"{path}: other users can read this secret; run: chmod 600 {path}")
    return _KeyPair(public, secret)


def _load(path: Path) -> tuple[bytes, bytes | None]:
    try:
        public, secret = zmq.auth.load_certificate(path)
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"{path}: the key cannot be read ({error}); make keys with --make-keys"
        ) from None
    for key in (public, secret):
        if key is not None and len(key) != _KEY_LENGTH:
            raise ConfigError(f"{path}: the key has {len(key)} characters; expected {_KEY_LENGTH}")
    return public, secret
