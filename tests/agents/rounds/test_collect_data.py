"""A data folder is added to with what its segments were driven with, and with nothing else. Nobody drives here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from tests.agents.danger.sights import small_config
from tests.agents.rounds.small_runs import NoiseWorkers
from wcsim.agents.danger.network import DangerNet, spec_of
from wcsim.agents.danger.policy import save_danger
from wcsim.agents.rounds.collect_data import DataOrder, collect_data
from wcsim.agents.rounds.drive_segment import SegmentOrder
from wcsim.agents.runs.data_folder import read_data_manifest
from wcsim.config.run_file import DangerRuleSettings
from wcsim.core.files import lock_run_folder
from wcsim.errors import ConfigError, PolicyError

PLANT = (Path(__file__).parents[3] / "examples" / "fwd.toml").read_text()


class OneDies(NoiseWorkers):
    """Drives noise, and dies at the second segment where it is told to."""

    dies = False

    def wait(self, orders: Sequence[SegmentOrder], told: object) -> dict[str, str]:
        done = super().wait(orders[:1] if self.dies else orders, told)
        if self.dies:
            raise KeyboardInterrupt
        return done


@pytest.fixture
def order(corner: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> DataOrder:
    monkeypatch.setattr("wcsim.agents.rounds.collect_data.SegmentWorkers", OneDies)
    return DataOrder(folder=tmp_path / "data", config=small_config(), towns=(str(corner),), seed=1, segments=2)


def die_at_second(order: DataOrder) -> None:
    """Begin to collect data, and die before it is whole."""
    with pytest.MonkeyPatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(OneDies, "dies", True)
        collect_data(order)


def test_a_folder_is_added_to_with_more_of_a_seed_and_with_other_seeds(order: DataOrder) -> None:
    collect_data(order)
    collect_data(replace(order, segments=3))
    collect_data(replace(order, seed=2, config=small_config("collect.follow_share=0.1")))
    assert len(read_data_manifest(order.folder).segments) == 5


@pytest.mark.parametrize("words", ["collect.follow_share=0.1", "collect.ticks=11", "cameras.0.noise=typical"])
def test_a_seed_that_was_driven_with_other_settings_is_refused(order: DataOrder, words: str) -> None:
    sha256 = collect_data(order)
    with pytest.raises(PolicyError, match=r"seed 1 .*another --seed"):
        collect_data(replace(order, config=small_config(words), segments=3))
    assert read_data_manifest(order.folder).data_sha256 == sha256


def test_a_seed_that_another_wheelchair_drove_is_refused_and_the_same_elsewhere_is_not(
    order: DataOrder, tmp_path: Path
) -> None:
    mine, copy = tmp_path / "mine.toml", tmp_path / "copy.toml"
    mine.write_text(PLANT)
    copy.write_text(PLANT)
    with_plant = replace(order, config=small_config(f"chair.plant={mine}"))
    die_at_second(with_plant)  # so that no data.json says what was driven
    mine.write_text(f"{PLANT}# another one\n")
    with pytest.raises(PolicyError, match=r"seed 1 .*another --seed"):
        collect_data(with_plant)
    collect_data(replace(order, config=small_config(f"chair.plant={copy}")))
    assert len(read_data_manifest(order.folder).segments) == 2


def test_a_seed_that_another_policy_drove_is_refused(order: DataOrder, tmp_path: Path) -> None:
    collect_data(order)
    with pytest.raises(PolicyError, match="another policy"):
        collect_data(replace(order, policy=str(a_policy(tmp_path))))


@pytest.mark.parametrize("words", ["env.actions=disc69", "cameras.0.width_px=40", "cameras.0.pitch_deg=10"])
def test_a_policy_of_other_senses_or_actions_is_refused_before_anything_is_begun(
    order: DataOrder, tmp_path: Path, words: str
) -> None:
    other = replace(order, policy=str(a_policy(tmp_path)), config=small_config(words))
    with pytest.raises(PolicyError) as refused:
        collect_data(other)
    named = words.partition("=")[0].split(".")[-1]
    assert f"({named} differ)" in str(refused.value) and "\n" not in str(refused.value)
    with pytest.raises(ConfigError, match="variants: 'nonsense' cannot be used"):
        collect_data(replace(other, config=small_config('collect.variants=["nonsense"]')))
    assert not order.folder.exists()
    collect_data(replace(other, config=order.config))


def a_policy(folder: Path) -> Path:
    """A danger network that learned nothing, with the settings of `small_config`."""
    config = small_config()
    return save_danger(folder / "policy", DangerNet(spec_of(config)), DangerRuleSettings(), config)


def test_a_drive_that_died_goes_on_with_its_own_settings_alone(order: DataOrder) -> None:
    die_at_second(order)
    with pytest.raises(PolicyError, match="another --seed"):
        collect_data(replace(order, config=small_config("cameras.0.width_px=40")))
    collect_data(order)
    assert len(read_data_manifest(order.folder).segments) == 2


def test_two_at_a_time_are_refused(order: DataOrder) -> None:
    collect_data(order)
    with lock_run_folder(order.folder), pytest.raises(PolicyError, match="in use by another process"):
        collect_data(replace(order, seed=2))
    collect_data(replace(order, seed=2))


def test_what_a_killed_one_had_begun_to_write_is_no_foreign_file(order: DataOrder) -> None:
    order.folder.mkdir()
    (order.folder / ".orders.json.tmp").write_text("{")
    collect_data(order)
    assert len(read_data_manifest(order.folder).segments) == 2
