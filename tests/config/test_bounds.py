"""A setting at either bound gives a street in which a chair drives and sees, or is refused in words; never a hang."""

import math
import multiprocessing
import signal
import typing
from collections.abc import Iterator
from itertools import pairwise

import gymnasium
import numpy as np
import pytest
from pydantic import BaseModel

import wcsim
from wcsim.config import RunConfig
from wcsim.errors import WcsimError

SECTIONS = ("world", "chair", "cameras", "imu", "sensors", "reward", "env")
LONGEST_S = 240  # by the clock, on a busy machine; an hour of warm-up takes most of it
SMALL = ("cameras.0.width_px=80", "cameras.0.height_px=60")


def ends(model: type[BaseModel], before: str) -> Iterator[tuple[str, str]]:
    """Both ends of each number of a section, as `key=value`."""
    for name, field in model.model_fields.items():
        parts = [field.annotation, *typing.get_args(field.annotation)]
        inner = [part for each in parts for part in (each, *typing.get_args(each))]
        tables = [part for part in inner if isinstance(part, type) and issubclass(part, BaseModel)]
        key = f"{before}.{name}"
        if tables:
            yield from ends(tables[0], key)
            continue
        bounds = [*field.metadata, *(bound for part in inner for each in getattr(part, "__metadata__", ())
                  for bound in (each, *getattr(each, "metadata", ())))]  # fmt: skip
        least = [each.ge for each in bounds if getattr(each, "ge", None) is not None]
        least += [math.nextafter(each.gt, math.inf) for each in bounds if getattr(each, "gt", None) is not None]
        most = [each.le for each in bounds if getattr(each, "le", None) is not None]
        if not least or not most or "dict" in str(field.annotation):
            continue
        several = str(field.annotation).count("FieldInfo") if "tuple" in str(field.annotation) else 0
        for value in (least[0], most[0]):
            yield key, f"{key}={[value] * several if several else value}"


def drive(*overrides: str) -> None:
    """Ten steps, in a process of its own; a refusal is fine, and all that is seen is finite."""
    signal.alarm(LONGEST_S)
    try:
        street = ("world.warmup_s=0", *SMALL, *overrides)
        env = gymnasium.make(wcsim.ENV_ID, town="monaco", overrides=street)
        _, info = env.reset(seed=1)
        for _ in range(10):
            seen, reward, ended, cut, info = env.step(info["user_action"])
            assert np.isfinite(float(reward)) and all(np.isfinite(np.asarray(part)).all() for part in seen.values())
            if ended or cut:
                _, info = env.reset()
        env.close()
    except WcsimError as error:
        assert str(error), "a refusal says why"


def ends_of(section: str) -> list[tuple[str, str]]:
    model = typing.get_args(RunConfig.model_fields[section].annotation) or (RunConfig.model_fields[section].annotation,)
    return list(ends(model[0], f"{section}.0" if section == "cameras" else section))


def codes(*drives: tuple[str, ...]) -> dict[tuple[str, ...], int | None]:
    """How the processes of drives ended, but for those that ended well."""
    context, found = multiprocessing.get_context("forkserver"), {}
    for overrides in drives:
        child = context.Process(target=drive, args=overrides)
        child.start()
        child.join()
        found[overrides] = child.exitcode
    return {overrides: code for overrides, code in found.items() if code != 0}


def test_the_ends_of_a_setting_are_found() -> None:
    assert ("cameras.0.near_m", "cameras.0.near_m=0.01") in ends_of("cameras")
    assert ("imu.p_BI_m", "imu.p_BI_m=[-2.0, -2.0, -2.0]") in ends_of("imu")
    assert sum(len(ends_of(section)) for section in SECTIONS) > 140


def test_the_ends_that_once_hung_or_crashed() -> None:
    assert codes(("cameras.0.near_m=0.01",)) == {}


@pytest.mark.proof
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("section", SECTIONS)
def test_each_number_at_both_ends(section: str) -> None:
    assert codes(*((said,) for _, said in ends_of(section))) == {}


@pytest.mark.proof
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("section", SECTIONS)
def test_neighbours_at_their_ends_together(section: str) -> None:
    pairs = [(one, other) for (name, one), (next_name, other) in pairwise(ends_of(section)) if name != next_name]
    assert codes(*pairs) == {}
