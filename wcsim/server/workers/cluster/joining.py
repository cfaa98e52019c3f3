"""How a process joins a Ray cluster, or makes one on this machine; whatever Ray says against it becomes one line."""

from __future__ import annotations

import os
import re
import secrets
import signal
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from wcsim.core.files import home
from wcsim.errors import ConfigError

LOCAL: Final = "local"
STORE_BYTES: Final = 160 << 20  # of objects on their way; what travels is small
_PATIENCE: Final = {"RAY_gcs_rpc_server_connect_timeout_s": "60", "RAY_raylet_start_wait_time_s": "80"}
"""For busy machines, where Ray's own 5 s for a process to start are too short."""
_LOOPBACK: Final = re.compile(r"127\.\d+\.\d+\.\d+|localhost|\[?::1\]?")
_VERSIONS: Final = re.compile(r"Ray: (\S+)\s+Python: (\S+)")


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkSpec:
    """What the process that speaks to Ray is told."""

    address: str  # HOST:PORT, or `local`
    count: int  # processes of a local cluster
    run: str  # a word that no other run has
    log: Path  # for what Ray says


def join(spec: LinkSpec) -> Any:
    """The module `ray`, joined. To be called once, in a process that is there for nothing else.

    Raises:
        ConfigError: Ray cannot join; with the cure.
    """
    _prepare(spec)
    import ray

    before = spec.log.stat().st_size if spec.log.exists() else 0
    try:
        if spec.address == LOCAL:
            ray.init(
                address=LOCAL,
                num_cpus=spec.count,
                num_gpus=0,
                include_dashboard=False,
                object_store_memory=STORE_BYTES,
                log_to_driver=False,
                configure_logging=False,
                _temp_dir=str(Path(tempfile.gettempdir()) / f"wcsim-ray-{os.getuid()}"),
            )
        else:
            ray.init(address=spec.address, log_to_driver=False, configure_logging=False)
    except Exception as error:
        raise ConfigError(_told(spec, error, ray, _logged(spec.log, before))) from None
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # Ray's own handler waits
    return ray


def _prepare(spec: LinkSpec) -> None:
    """What Ray reads of its environment when it is loaded; this process and those that it starts are its only users."""
    os.environ["RAY_USAGE_STATS_ENABLED"] = "0"
    for name, seconds in _PATIENCE.items():
        os.environ.setdefault(name, seconds)
    if spec.address == LOCAL or _is_loopback(spec.address):
        os.environ["RAY_ENABLE_WINDOWS_OR_OSX_CLUSTER"] = "0"  # Ray's word for: on 127.0.0.1, not on all addresses
    if spec.address == LOCAL:
        os.environ["RAY_AUTH_MODE"] = "token"
        os.environ["RAY_AUTH_TOKEN"] = secrets.token_hex(32)  # known to nobody else, and on no disk
    elif _has_token():
        os.environ.setdefault("RAY_AUTH_MODE", "token")  # without a word Ray shows a token to no cluster that it joins


def _has_token() -> bool:
    """Whether this user has one, in any of the places where Ray looks."""
    own = home()
    named = any(os.environ.get(name) for name in ("RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH"))
    return named or (own is not None and (own / ".ray" / "auth_token").is_file())


def _is_loopback(address: str) -> bool:
    """Whether a HOST:PORT is of this machine alone.

    >>> _is_loopback("127.0.0.1:6379"), _is_loopback("10.0.0.1:6379")
    (True, False)
    """
    return _LOOPBACK.fullmatch(address.rpartition(":")[0]) is not None


def _logged(log: Path, before: int) -> str:
    """What Ray has written beside what it raises, which names no token where none was shown."""
    with suppress(OSError), log.open("rb") as file:
        file.seek(before)
        return file.read(1 << 20).decode("utf-8", "replace")
    return ""


def _told(spec: LinkSpec, error: Exception, ray: Any, logged: str = "") -> str:
    text = str(error)
    found = _VERSIONS.findall(text)
    if "ersion mismatch" in text and found:
        (theirs, python), ours = found[0], _VERSIONS.findall(text)[-1]
        return (
            f"--cluster {spec.address} runs Ray {theirs} with Python {python}; expected Ray {ours[0]} with Python "
            f"{ours[1]}, as here: install that on its nodes, or python -m pip install 'ray=={theirs}' here"
        )
    kind = type(error).__name__
    if kind == "AuthenticationError" or "auth" in text.lower() or "InvalidAuthToken" in logged:
        return (
            f"--cluster {spec.address} needs its token, and this user has none or another one; copy the "
            "head's file ~/.ray/auth_token to this machine, readable by you alone (chmod 600)"
        )
    first = next((line.strip() for line in text.splitlines() if line.strip()), kind)
    return (
        f"--cluster {spec.address}: Ray {ray.__version__} cannot join ({kind}: {first[:200]}); expected the address of "
        f"a head, and a node on this machine: `ray start --address={spec.address}`; Ray's messages are in {spec.log}"
    )
