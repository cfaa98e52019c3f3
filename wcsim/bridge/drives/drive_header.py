"""What the header of a recorded drive says of the world that it is driven in."""

from __future__ import annotations

from wcsim.bridge.recording.fingerprint import fingerprint
from wcsim.config import RunConfig
from wcsim.log.drive import wcsim_version
from wcsim.log.records import PERSON, DriveHeader, Header
from wcsim.towns.scenario.town import Town, content_hash
from wcsim.types import SeatSpec
from wcsim.users.profiles import UserProfile, profile_json


def drive_header(
    town: Town,
    config: RunConfig,
    seed: int,
    spec: SeatSpec,
    user: UserProfile | None,
    **assisted: str,
) -> Header:
    """The header of a drive.

    Args:
        town: Where.
        config: Of the world.
        seed: Of the world.
        spec: Of the only seat.
        user: The simulated user as it was drawn; None when a person drives.
        assisted: Of `DriveHeader`: policy, level, episode, beside and scene.
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
        drive=DriveHeader(
            wcsim=wcsim_version(),
            profile=PERSON if user is None else user.name,
            user="" if user is None else profile_json(user),
            max_steps=spec.max_steps,
            start=spec.start,
            **assisted,
        ),
    )
