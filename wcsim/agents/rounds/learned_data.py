"""Which driving of others a run learns from: noted when it begins, as a folder may grow before the run goes on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from wcsim.agents.collecting.data_folder import SEGMENTS, read_manifest, read_segment, require_same_settings
from wcsim.agents.collecting.segment import Segment
from wcsim.agents.runs.run_folder import RunFolder, with_whole_data
from wcsim.config import parse
from wcsim.config.run_file import LearnedFile
from wcsim.core import files
from wcsim.core.reading import FileKind, escaped, is_file, read_json
from wcsim.errors import ConfigError, PolicyError

LEARNED: Final = "learned_data.json"
_KIND: Final = FileKind(what="the learned_data.json of a run", limit_bytes=64 << 20, error=PolicyError)


def data_of(run: RunFolder) -> dict[str, dict[str, str]]:
    """The segments of each data folder that a run learns from, SHA-256 by file name: those that it began with.

    Raises:
        PolicyError: A folder is none or was driven with other settings, or what the run has noted is damaged.
    """
    path = run.path / LEARNED
    if is_file(path):
        try:
            return parse(LearnedFile, read_json(path, _KIND), escaped(path)).folders
        except ConfigError as error:
            raise PolicyError(str(error)) from None
    found = {}
    for folder in with_whole_data(run.config).collect.data:
        file = read_manifest(Path(folder))
        require_same_settings(Path(folder), file, run.config)
        found[folder] = file.segments
    return found


def learned_segments(run: RunFolder) -> Iterator[Segment]:
    """What a run learns from beside its own driving, always the same; it is noted before the first of it is read.

    Raises:
        PolicyError: As `data_of`; there is nothing at all to learn from; or a segment is gone, damaged or exchanged.
        DiskFullError: There is no room.
    """
    found, path = data_of(run), run.path / LEARNED
    if not any(found.values()) and run.config.collect.segments == 0:
        raise PolicyError(
            f"{', '.join(map(escaped, found)) or 'collect.data'}: holds no data to learn from; expected segments of "
            "`wcsim collect`, or collect.segments of 1 or more"
        )
    if found and not is_file(path):
        files.write_json(path, {"schema_version": 1, "folders": found})
    for folder, segments in found.items():
        for name in sorted(segments):
            try:
                yield read_segment(Path(folder) / SEGMENTS / name, segments[name])
            except PolicyError as error:
                told = "the run needs the data that it started with: restore it, or start a new run"
                raise PolicyError(f"{error}; {escaped(path)} names it, as {told}") from None
