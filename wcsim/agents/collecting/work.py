"""Drives a piece of work in this process: its worlds one after the other, as one segment."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

from wcsim.agents.collecting.drive_segment import MakeLearned, drive_segment
from wcsim.agents.collecting.segment import Segment, joined
from wcsim.agents.collecting.segment_places import SegmentOrder, driving_seed, places_of


def collect(order: SegmentOrder, make_learned: MakeLearned | None) -> Segment:
    """The segment that an order asks for; the same one wherever and whenever it is driven.

    Raises:
        TownError: A town is missing.
    """
    with TemporaryDirectory(prefix="wcsim-collect-") as work:
        parts = [
            drive_segment(place, make_learned, driving_seed(order.key, number))
            for number, place in enumerate(places_of(order, Path(work)))
        ]
    return joined(parts)
