"""What the header of a recorded drive says of the world that it is driven in."""

from __future__ import annotations

from wcsim.bridge.recording.fingerprint import fingerprint
from wcsim.config import RunConfig
from wcsim.log.drive import wcsim_version
from wcsim.log.records import DriveHeader, Header
from wcsim.towns.scenario.town import Town, content_hash


def drive_header(town: Town, config: RunConfig, seed: int, **driven: str) -> Header:
    """The header of a drive.

    Args:
        town: Where.
        config: Of the world.
        seed: Of the world.
        driven: Of `DriveHeader`: profile, policy, level, episode and scene.
    """
    return Header(
        fingerprint=fingerprint(),
        town=town.address,
        town_name=town.name,
        town_sha256=content_hash(town),
        seed=seed,
        seats=1,
        tick_s=config.world.tick_s,
        config=config.model_dump_json(),
        drive=DriveHeader(wcsim=wcsim_version(), **driven),
    )
