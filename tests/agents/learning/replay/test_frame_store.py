"""A frame comes back from its blob whatever is in it, and a noisy depth picture is packed well."""

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from wcsim.agents.learning.replay.frame_store import BlobCodec


@settings(max_examples=200)
@given(st.binary(min_size=1, max_size=300), st.integers(0, 300), st.booleans())
def test_a_frame_comes_back(data, smooth, without_holes):
    frame = np.frombuffer(data, np.uint8)
    frame = np.maximum(frame, 1) if without_holes else frame
    codec = BlobCodec(len(frame), min(smooth, len(frame)))
    assert np.array_equal(codec.unpack(codec.pack(frame)), frame)


def test_a_noisy_depth_picture_with_holes_is_smaller_than_as_it_is():
    g = np.random.default_rng(0)
    depth = (120 + 60 * np.sin(np.arange(76_800) / 300) + g.normal(0, 0.8, 76_800)).astype(np.uint8)
    depth[np.repeat(g.random(7_680) < 0.05, 10)] = 0
    classes = np.repeat(g.integers(0, 30, 768, dtype=np.uint8), 100)
    frame, codec = np.concatenate([depth, classes]), BlobCodec(153_600, 76_800)
    assert len(codec.pack(frame)) < 0.8 * len(zstandard.ZstdCompressor(level=1).compress(frame.tobytes()))


@pytest.mark.parametrize("size", [90, 110])
def test_a_blob_of_another_frame_is_refused(size):
    blob = BlobCodec(100, 50).pack(np.arange(100, dtype=np.uint8))
    with pytest.raises((ValueError, zstandard.ZstdError)):
        BlobCodec(size, 50).unpack(blob)
    with pytest.raises(ValueError, match="3 bytes"):
        BlobCodec(100, 50).unpack(blob[:3])


def test_a_blob_that_would_be_larger_than_its_frame_is_refused_before_it_is():
    blob = BlobCodec(1 << 20, 50).pack(np.zeros(1 << 20, np.uint8))
    assert len(blob) < 300
    with pytest.raises(ValueError, match="more than 50 bytes"):
        BlobCodec(100, 50).unpack(blob)
