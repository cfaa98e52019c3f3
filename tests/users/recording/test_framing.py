from __future__ import annotations

import io

from wcsim.users.recording.framing import framed, torn_bytes, whole_records


class Growing(io.BytesIO):
    """A file to which a record is added right after somebody has come to its end."""

    def __init__(self, data: bytes, more: bytes) -> None:
        super().__init__(data)
        self._more = more

    def read(self, size: int | None = -1) -> bytes:
        data = super().read(size)
        if not data and self._more:
            at = self.tell()
            self.seek(0, io.SEEK_END)
            self.write(self._more)
            self._more = b""
            self.seek(at)
        return data


def test_what_is_written_while_somebody_looks_at_the_end_is_no_damage():
    first, second = framed(b"one"), framed(b"two")
    file = Growing(first, second)
    assert torn_bytes(file, len(first)) == 0
    file.seek(len(first))
    assert [record.payload for record in whole_records(file)] == [b"two"]


def test_what_is_torn_whole_or_damaged_is_told_apart():
    first, second = framed(b"one"), framed(b"two" * 50)
    for end, after, told in (
        (first, b"", 0),
        (first, second[:-1], len(second) - 1),
        (first, bytes(8), 8),
        (first, second, -1),
        (first, b"\x05" + second, None),
    ):
        assert torn_bytes(io.BytesIO(end + after), len(end)) == told
