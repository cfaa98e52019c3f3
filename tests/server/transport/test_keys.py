import stat

import pytest

from wcsim.errors import ConfigError
from wcsim.server.transport.keys import (
    create_missing_keys,
    is_loopback,
    read_client_keys,
    read_server_keys,
    read_server_public_key,
)


def test_keys_are_made_once_and_secrets_are_their_owners_alone(tmp_path):
    assert create_missing_keys(tmp_path, ("a", "b")) == ("a", "b")
    before = read_server_keys(tmp_path)
    assert create_missing_keys(tmp_path, ("b", "c")) == ("c",)
    assert read_server_keys(tmp_path) == before
    assert read_server_public_key(tmp_path) == before.public
    assert read_client_keys(tmp_path, "a") != read_client_keys(tmp_path, "b")
    secrets = list(tmp_path.rglob("*.secret"))
    assert len(secrets) == 4
    assert all(stat.S_IMODE(path.stat().st_mode) == 0o600 for path in secrets)
    assert not any(b"secret-key" in path.read_bytes() for path in tmp_path.rglob("*.public"))


def test_the_only_secret_serves_a_client_of_another_name(tmp_path):
    create_missing_keys(tmp_path, ("a",))
    assert read_client_keys(tmp_path, "fig6") == read_client_keys(tmp_path, "a")
    create_missing_keys(tmp_path, ("b",))
    with pytest.raises(ConfigError, match="2 other secret keys"):
        read_client_keys(tmp_path, "fig6")
    with pytest.raises(ConfigError, match="2 other secret keys"):
        read_client_keys(tmp_path, "../server")


def test_what_cannot_be_a_key_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"client name '\.\./x'"):
        create_missing_keys(tmp_path, ("../x",))
    with pytest.raises(ConfigError, match=r"server\.public"):
        read_server_public_key(tmp_path)
    create_missing_keys(tmp_path, ("a",))
    (tmp_path / "server.secret").chmod(0o644)
    with pytest.raises(ConfigError, match="chmod 600"):
        read_server_keys(tmp_path)
    (tmp_path / "server.public").write_text('public-key = "short"\n')
    with pytest.raises(ConfigError, match="5 characters"):
        read_server_public_key(tmp_path)


@pytest.mark.parametrize(
    "address, loopback",
    [
        ("tcp://127.0.0.1:1", True),
        ("tcp://127.9.9.9:*", True),
        ("tcp://localhost:5", True),
        ("tcp://[::1]:5", True),
        ("tcp://0.0.0.0:5", False),
        ("tcp://*:5", False),
        ("tcp://eth0:5", False),
        ("tcp://10.0.0.1:5", False),
        ("tcp://[::]:5", False),
        ("tcp://example.org:5", False),
    ],
)
def test_only_loopback_is_loopback(address, loopback):
    assert is_loopback(address) is loopback


@pytest.mark.parametrize("address", ["", "tcp://", "tcp://x", "tcp://127.0.0.1:70000", "ipc:///x", "tcp://a:1:2"])
def test_what_is_no_address_is_refused(address):
    with pytest.raises(ConfigError, match="HOST:PORT"):
        is_loopback(address)
