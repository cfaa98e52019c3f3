"""Access control: checks of a request's host, origin and token, without any socket."""

import hmac
import re
import secrets
from dataclasses import dataclass
from typing import Final
from urllib.parse import parse_qs, urlsplit

LOOPBACK: Final = ("127.0.0.1", "localhost", "::1")
_ANYWHERE: Final = ("0.0.0.0", "::")  # noqa: S104 - only on request, and only with a token
_HOST: Final = re.compile(r"(?P<name>\[[0-9a-fA-F:]{2,45}\]|[A-Za-z0-9.-]{1,253})(?::[0-9]{1,5})?")
_TOKEN_BYTES: Final = 24


def new_token() -> str:
    """A secret for the address of a page."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


@dataclass(frozen=True, slots=True, kw_only=True)
class AccessControl:
    """Accepts requests that know the printed address.

    A page of another site can make a browser connect to this machine. It can also give its own name
    this machine's address. So the host name of a request has to be one of ours, and its origin has
    to be that host.
    """

    host: str  # at which the server listens
    token: str = ""  # required of every page where there is one

    def refusal(self, host: str | None, origin: str | None, path: str, *, socket: bool) -> str:
        """Why a request is refused; "" for one that is accepted.

        Args:
            host: Its header Host.
            origin: Its header Origin; None without one.
            path: With its query.
            socket: It asks for a socket, not only for a file of the page.
        """
        found = _HOST.fullmatch(host or "")
        if found is None or not self._is_ours(found["name"].strip("[]").lower()):
            return "this host name is not served here; open the printed address"
        if socket and origin is None:
            return "the Origin header is missing; open the printed address"
        if origin is not None and origin.lower() != f"http://{host}".lower():
            return "a page of another site may not connect"
        asked = urlsplit(path)
        asks = socket or asked.path == "/" or asked.path.startswith("/street/")
        said = parse_qs(asked.query).get("token", [""])[0]
        if self.token and asks and not hmac.compare_digest(said.encode(), self.token.encode()):
            return "the token is missing or wrong; open the printed address"
        return ""

    def _is_ours(self, name: str) -> bool:
        if self.host in _ANYWHERE:
            return bool(self.token)
        return name == self.host.lower() or (self.host in LOOPBACK and name in LOOPBACK)


def content_policy(host: str) -> str:
    """What the page may load, as a header: only its own files and its own socket.

    >>> "connect-src 'self' ws://127.0.0.1:8080" in content_policy("127.0.0.1:8080")
    True
    """
    return (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
        f"connect-src 'self' ws://{host}; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
