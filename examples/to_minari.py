"""A data folder as a Minari dataset: `python to_minari.py FOLDER ID`; pip install 'minari[hdf5]' pillow zstandard."""

import io
import sys
from pathlib import Path

import minari
import numpy as np
import zstandard
from gymnasium.spaces import Box, Dict, Discrete

PICTURES, NUMBERS = ("depth", "seg"), ("imu", "stick")
EPISODES, LARGE = [], np.float32(1e9)

for file in sorted(Path(sys.argv[1]).glob("segments/*.npz.zst")):
    rows = np.load(io.BytesIO(zstandard.decompress(file.read_bytes())))
    rows = {name: rows[name] for name in rows}
    for part in np.split(np.arange(len(rows["action"])), np.flatnonzero(rows["ended"])[:-1] + 1):
        seen = [*part, part[-1]]  # the last observation stands twice, as a segment holds none after the last step
        EPISODES.append(
            minari.data_collector.EpisodeBuffer(
                observations={name: rows[name][seen] for name in PICTURES + NUMBERS},
                actions=rows["action"][part].astype(np.int64),
                rewards=rows["reward"][part],
                terminations=rows["crashed"][part],
                truncations=(rows["ended"] & ~rows["crashed"])[part],
            )
        )
spaces = {name: Box(0, 255, rows[name].shape[1:], np.uint8) for name in PICTURES}
spaces |= {name: Box(-LARGE, LARGE, rows[name].shape[1:]) for name in NUMBERS}
minari.create_dataset_from_buffers(
    sys.argv[2],
    EPISODES,
    observation_space=Dict(spaces),
    action_space=Discrete(rows["visible"].shape[1]),
    jpeg_encoding=False,  # which is lossy, and classes are numbers
)
