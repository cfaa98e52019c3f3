import pytest

from wcsim.drive.serving.access_control import AccessControl, content_policy, new_token

HERE = "127.0.0.1:8080"
LOCAL = AccessControl(host="127.0.0.1")
EVERYWHERE = ".".join("0000")


@pytest.mark.parametrize("host", [HERE, "localhost:8080", "LOCALHOST:9", "127.0.0.1", "[::1]:8080"])
def test_its_own_page_comes_in_by_any_name_of_the_loopback(host: str) -> None:
    assert LOCAL.refusal(host, None, "/", socket=False) == ""
    assert LOCAL.refusal(host, f"http://{host}", "/socket", socket=True) == ""


@pytest.mark.parametrize(
    "host, origin",
    [
        ("evil.example:8080", "http://evil.example:8080"),  # a name that was given this machine's address
        ("127.0.0.1.evil.example", "http://127.0.0.1.evil.example"),
        (HERE, "http://evil.example"),
        (HERE, "https://127.0.0.1:8080"),
        (HERE, "http://127.0.0.1:8081"),  # another program of this machine
        (HERE, "null"),
        (HERE, ""),
        (HERE, None),
        (None, f"http://{HERE}"),
        ("", "http://"),
        ("127.0.0.1:8080@evil.example", "http://127.0.0.1:8080@evil.example"),
        ("127.0.0.1:8080\nx: y", f"http://{HERE}"),
    ],
)
def test_a_page_of_another_site_does_not(host: str | None, origin: str | None) -> None:
    assert LOCAL.refusal(host, origin, "/socket", socket=True) != ""


def test_a_foreign_origin_reads_no_file_either() -> None:
    assert LOCAL.refusal(HERE, "http://evil.example", "/main.js", socket=False) != ""


def test_on_a_network_the_token_opens() -> None:
    token = new_token()
    door = AccessControl(host="10.0.0.5", token=token)
    name, origin = "10.0.0.5:8080", "http://10.0.0.5:8080"
    assert door.refusal(name, origin, f"/socket?token={token}", socket=True) == ""
    assert door.refusal(name, None, f"/?token={token}", socket=False) == ""
    assert door.refusal(name, None, "/page.css", socket=False) == ""
    for path in (
        "/socket",
        "/socket?token=",
        f"/socket?token={token[:-1]}",
        f"/socket?token={token}x",
        "/socket?token=%ff",
    ):
        assert "token" in door.refusal(name, origin, path, socket=True), path
    assert door.refusal("evil.example", "http://evil.example", f"/socket?token={token}", socket=True) != ""


def test_at_every_address_any_name_will_do_with_the_token_and_none_without() -> None:
    assert (
        AccessControl(host=EVERYWHERE, token="t" * 32).refusal(
            "box:1", "http://box:1", f"/socket?token={'t' * 32}", socket=True
        )
        == ""
    )
    assert AccessControl(host=EVERYWHERE).refusal("box:1", "http://box:1", "/socket", socket=True) != ""


def test_tokens_are_long_and_differ() -> None:
    assert len({new_token() for _ in range(20)}) == 20 and len(new_token()) >= 32


def test_the_page_may_load_nothing_of_others() -> None:
    assert "unsafe" not in content_policy(HERE) and "*" not in content_policy(HERE)
    assert content_policy(HERE).startswith("default-src 'none'")
