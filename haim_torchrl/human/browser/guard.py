"""Who may connect: token, origin and host of every request."""

from __future__ import annotations

import hmac
import ipaddress
from collections.abc import Mapping
from dataclasses import dataclass
from urllib.parse import urlsplit

HEADERS = {
    "content-security-policy": (
        "default-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    ),
    "cache-control": "no-store",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
}
"""Sent with every answer: the page loads nothing from elsewhere, and nobody may embed it."""


@dataclass(frozen=True)
class Guard:
    """Decides on requests.

    Attributes:
        host: where the server listens.
        token: what the address has to hold; None asks for none.
        origins: further origins from which the page may come, such as that of a reverse proxy
            (``"https://lab.example.org"``).
    """

    host: str
    token: str | None = None
    origins: tuple[str, ...] = ()

    def refuse(
        self, headers: Mapping[str, str], query: Mapping[str, str], *, secret: bool = True
    ) -> str | None:
        """Why a request is refused, in one sentence; None if it is not.

        Args:
            headers: of the request, names in lower case.
            query: of its address.
            secret: whether what is asked for is behind the token.
        """
        host = headers.get("host", "")
        if not self._knows(host):
            return f"{host or 'No host'} is not a name of this server."
        origin = headers.get("origin")
        if origin is not None and not self._may_come_from(origin, host):
            return f"Pages of {origin} may not connect here."
        given = query.get("token", "").encode()
        if secret and self.token is not None:
            if not given:
                return "The token is missing: open the address that the terminal shows."
            if not hmac.compare_digest(given, self.token.encode()):
                return "The token is wrong: open the address that the terminal shows."
        return None

    def _knows(self, host: str) -> bool:
        """Whether the name is ours.

        On a loopback address a page from elsewhere could reach us under its own name, if that name
        leads here (DNS rebinding). Elsewhere the token keeps such pages out.
        """
        name = host_name(host)
        if not is_loopback(self.host):
            return name != ""
        known = {
            self.host.strip("[]").lower(),
            *(host_name(urlsplit(o).netloc) for o in self.origins),
        }
        return name != "" and (is_loopback(name) or name in known)

    def _may_come_from(self, origin: str, host: str) -> bool:
        if origin.rstrip("/") in {known.rstrip("/") for known in self.origins}:
            return True
        parts = urlsplit(origin)
        return parts.scheme in ("http", "https") and parts.netloc.lower() == host.lower()


def is_loopback(host: str) -> bool:
    """Whether a name or address leads to this machine alone.

    Example:
        >>> is_loopback("localhost"), is_loopback("127.0.0.1"), is_loopback("0.0.0.0")
        (True, True, False)
    """
    name = host.strip("[]").lower().rstrip(".")
    try:
        return ipaddress.ip_address(name).is_loopback
    except ValueError:
        return name == "localhost"


def host_name(netloc: str) -> str:
    """The name in a Host header, without port, in lower case; "" if there is none.

    Example:
        >>> host_name("Localhost:8765"), host_name("[::1]:80"), host_name("")
        ('localhost', '::1', '')
    """
    try:
        return (urlsplit(f"//{netloc}").hostname or "").lower()
    except ValueError:
        return ""
