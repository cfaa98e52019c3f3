"""The one door for files."""

import os
import time
import tracemalloc
from pathlib import Path

import pytest
import zstandard

from wcsim.core.reading import (
    FileSpec,
    decompress_zstd,
    escape,
    open_regular_file,
    parse_json,
    parse_toml,
    read_bytes,
    read_json,
    read_text,
    read_toml,
)
from wcsim.errors import ConfigError, FileError, JournalError, PolicyError, TownError

KIND = FileSpec(what="a small file", limit_bytes=1000)


@pytest.mark.parametrize("kind", [ConfigError, TownError, PolicyError, JournalError])
def test_whatever_is_wrong_is_one_error(kind: type[FileError], tmp_path: Path) -> None:
    wanted = FileSpec(what="a small file", limit_bytes=10, error=kind)
    large, latin, pipe = tmp_path / "large", tmp_path / "latin", tmp_path / "pipe"
    large.write_bytes(b"x" * 11)
    latin.write_bytes(b"\xe9")
    os.mkfifo(pipe)
    odd = (tmp_path / "none", tmp_path, Path("a\0b"), pipe, Path("/dev/zero"), large, latin, Path("x" * 5000))
    for path in odd:
        with pytest.raises(kind):
            read_text(path, wanted)


def test_a_file_is_read_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    path.write_bytes(b"\xef\xbb\xbfa = 1\n")
    assert read_text(path, KIND) == "a = 1\n"
    assert read_toml(path, KIND) == {"a": 1}
    assert read_bytes(path, FileSpec(what="", limit_bytes=9)) == path.read_bytes()
    with open_regular_file(path, KIND) as file:
        assert len(file.read()) == 9
    path.write_text('{"a": [1, 2.5, null]}', encoding="utf-8")
    assert read_json(path, KIND) == {"a": [1, 2.5, None]}


@pytest.mark.parametrize(
    "text",
    [
        "[" * 100_000, '{"a":' * 100_000, '{"a":' * 40 + "1" + "}" * 40, '{"a": 1, "a": 2}', '{"a": NaN}',
        '{"a": 1e999}', '{"a": ' + "9" * 5000 + "}", '{"a": 18446744073709551616}', "[]", "", "nul", '{"a": "\ud800',
    ],
)  # fmt: skip
def test_json_that_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=r"^here: "):
        parse_json(text, "here", KIND)


def test_json_that_would_fill_the_memory_is_not_parsed(tmp_path: Path) -> None:
    bomb = '{"a": [' + "[]," * (1 << 20) + "[]]}"
    kind = FileSpec(what="a recording", limit_bytes=1 << 30, error=JournalError)
    tracemalloc.start()
    try:
        with pytest.raises(JournalError, match="characters of JSON; expected at most 1048576"):
            parse_json(bomb, "here", kind)
        assert tracemalloc.get_traced_memory()[1] < len(bomb)
    finally:
        tracemalloc.stop()
    (tmp_path / "a.json").write_text('{"a": "' + "x" * (1 << 20) + '"}')
    assert read_json(tmp_path / "a.json", kind), "a file of its own is bounded by its kind"


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * 100_000, "a = " + "{a=" * 100_000, "a = " + "9" * 5000, "a." * 50_000 + "a = 1",
        "[" + "'a' . " * 20 + "a]", "a = inf", "a = 18446744073709551616", "a = 1\na = 2", "a", "a = {b = 1, b = 2}",
    ],
)  # fmt: skip
def test_toml_that_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match=r"^here: "):
        parse_toml(text, "here", KIND)


def test_sound_text_goes_through() -> None:
    assert parse_toml("a.b.c = '" + "x." * 14 + "'\n[d]\ne = -18446744073709551615", "here", KIND)["d"] == {
        "e": -18446744073709551615
    }
    assert parse_json('{"a": ' + "[" * 31 + "]" * 31 + "}", "here", KIND)


def test_a_long_text_costs_time_in_proportion_to_its_length() -> None:
    def cost_s(size: int) -> float:
        begun_s = time.process_time()
        with pytest.raises(ConfigError):
            parse_toml('"' * size + "a" * size + "'" * size, "here", KIND)
        return time.process_time() - begun_s

    few, many = min(cost_s(20_000) for _ in range(3)), cost_s(320_000)
    assert many < 100 * few  # 16 for a proportion, 256 for a square


def test_what_is_shown_is_printable_and_short() -> None:
    assert escape("a\x1b[2Jb\n\u202ec") == "a\\x1b[2Jb\\n\\u202ec"
    assert len(escape("\x1b" * 10_000)) == 160
    assert escape("é ü") == "é ü"


def test_a_frame_that_holds_as_much_as_allowed_is_unpacked_and_more_is_refused() -> None:
    packed = zstandard.compress(bytes(1000))
    assert decompress_zstd(packed, 1000) == decompress_zstd(packed, 1000, zstandard.ZstdDecompressor()) == bytes(1000)
    with pytest.raises(ValueError, match="more than 999 bytes"):
        decompress_zstd(packed, 999)


def test_a_frame_that_says_nothing_of_its_size_is_bounded_all_the_same() -> None:
    packer = zstandard.ZstdCompressor().compressobj()
    packed = packer.compress(bytes(1 << 20)) + packer.flush()
    assert zstandard.frame_content_size(packed) == -1
    with pytest.raises(zstandard.ZstdError):
        decompress_zstd(packed, 1000)
    assert decompress_zstd(packed, 1 << 20) == bytes(1 << 20)


def test_an_empty_frame_is_no_bytes() -> None:
    assert decompress_zstd(zstandard.compress(b""), 0) == b""


def test_a_file_that_is_too_large_is_refused_unread(tmp_path: Path) -> None:
    path, kind = tmp_path / "a", FileSpec(what="a file", limit_bytes=256 << 20)
    with path.open("wb") as file:
        file.truncate(kind.limit_bytes + 1)
    tracemalloc.start()
    with pytest.raises(ConfigError, match="larger than"):
        read_bytes(path, kind)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert most < kind.limit_bytes / 100
