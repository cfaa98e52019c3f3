import io
import struct
import time
import zlib

from tests.support.framing import chained
from wcsim.log.framing import (
    MOST_TRUNCATED_BYTES,
    count_truncated_bytes,
    crc_from_record,
    frame_payload,
    iter_whole_records,
)


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
    first = frame_payload(b"one")
    second = frame_payload(b"two", crc_from_record(first))
    file = Growing(first, second)
    assert count_truncated_bytes(file, len(first), crc_from_record(first)) == 0
    file.seek(len(first))
    assert [record.payload for record in iter_whole_records(file, crc_from_record(first))] == [b"two"]


def test_what_is_torn_whole_or_damaged_is_told_apart():
    first = frame_payload(b"one")
    second = frame_payload(b"two" * 50, crc_from_record(first))
    for end, after, told in (
        (first, b"", 0),
        (first, second[:-1], len(second) - 1),
        (first, bytes(8), 8),
        (first, second, "appended"),
        (first, b"\x05" + second, "damaged"),
    ):
        assert count_truncated_bytes(io.BytesIO(end + after), len(end), crc_from_record(first)) == told


def cost_s(rest: bytes) -> tuple[float, int | str]:
    """Processor time of a look at a torn end, and its answer."""
    begun_s = time.process_time()
    told = count_truncated_bytes(io.BytesIO(rest), 0)
    return time.process_time() - begun_s, told


def test_a_torn_end_of_many_beginnings_costs_little_and_is_damage():
    """Each begins a stream in the block of the one before, and all go on to the same end."""
    chain = b"\x78\x9c\x00\x02\x00\xfd\xff"
    packer = zlib.compressobj()
    bomb = b"\x78\x9c" + (packer.compress(bytes(32 << 20)) + packer.flush(zlib.Z_SYNC_FLUSH))[2:]
    torn = struct.pack("<II", 1 << 20, 1)
    once_s, _ = cost_s(torn + bomb)
    for count in (100, (MOST_TRUNCATED_BYTES - 8 - len(bomb)) // len(chain)):
        many_s, told = cost_s(torn + chain * count + bomb)
        assert told == "damaged", "nothing is cut off that was not looked through"
        assert many_s < 20 * once_s


def test_a_record_that_unpacks_to_far_more_than_it_has_is_none():
    sound = chained([bytes(4000), bytes(range(256)) * 30, b"two"])
    assert len(list(iter_whole_records(io.BytesIO(sound)))) == 3
    two = chained([b"two", bytes(1 << 20), b"two"])
    assert [record.payload for record in iter_whole_records(io.BytesIO(two))] == [b"two"]
    for rest in (frame_payload(bytes(1 << 20)), chained([bytes(1 << 20), b"two"])):
        assert count_truncated_bytes(io.BytesIO(rest), 0) == "damaged"
