"""Does the danger network learn, and is that noticed when it does not? Each part alone, on streets that it never saw.

Slides (`toy_rides.slides`) are ticks in streets of their own: 1200 to learn from, 300 to be judged by, of whose labels
a sixth are unsafe. Processor seconds on a busy core: 3 for the slides, then 3 (`gaps`), 7 (`roll_out`), 15 (`context`).
A precision as of chance is 0.165, the share that is told from its mirror image 0.5, the bits that are known 0.
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest
import torch

from tests.agents.danger.sights import Silent, all_of, lessons_of
from tests.agents.danger.toy_rides import ACTIONS, follow, mixed, ride, segment_of, slides, toy_config
from wcsim.agents.danger import dataset as dataset_module
from wcsim.agents.danger.dataset import Dataset
from wcsim.agents.danger.learner import DangerLearner
from wcsim.agents.danger.policy import DangerPolicy
from wcsim.agents.runs.data_folder import SAFE
from wcsim.config.run_file import DangerRuleSettings

ALONE = {
    "roll_out": ("danger.batch=16", "danger.learning_rate=0.005"),
    "context": ("danger.width=16", "danger.batch=16", "danger.learning_rate=0.003"),
}
OTHER = {"roll_out": "context", "context": "roll_out"}  # which says nothing meanwhile
UPDATES = {"roll_out": 250, "context": 900}


@dataclass(frozen=True, kw_only=True)
class Known:
    """What a network knows of slides that it never saw."""

    precision: float  # average precision over all positions
    sides: float  # of positions that are unsafe and whose mirror image is not: how often the worse one is told
    bits: float  # share of the labels' entropy that is gone


BAR = Known(precision=0.87, sides=0.92, bits=0.6)


@pytest.fixture(scope="module")
def streets():
    """Slides to learn from, and to be judged by; there the street's own labels count, not those of `Dataset`."""
    return slides(toy_config(), 1200, seed=1), slides(toy_config(), 300, seed=2)


def judged(logits, unsafe):
    """Logits and labels (N, A)."""
    order = np.argsort(-logits.ravel(), kind="stable")
    hits = unsafe.ravel()[order]
    precision = (np.cumsum(hits) / np.arange(1, len(hits) + 1))[hits].mean()
    one_sided = unsafe & ~unsafe[:, ACTIONS.mirror]
    share = unsafe.mean()
    entropy = -(share * np.log(share) + (1.0 - share) * np.log(1.0 - share))
    labels = torch.from_numpy(unsafe).float()
    loss = float(torch.nn.functional.binary_cross_entropy_with_logits(torch.from_numpy(logits), labels))
    return Known(
        precision=float(precision),
        sides=float((logits > logits[:, ACTIONS.mirror])[one_sided].mean()),
        bits=1.0 - loss / float(entropy),
    )


def learned(part, seed, streets):
    """What this part alone knows after its updates."""
    config, (shown, held) = toy_config(*ALONE[part]), streets
    asked = lessons_of(config, held)
    learner = DangerLearner(config, seed, UPDATES[part])
    setattr(learner.net, OTHER[part], Silent())
    learner.learn(lessons_of(config, shown, seed), UPDATES[part])
    with torch.inference_mode():
        parts = [learner.net(*asked.batch(rows).inputs).numpy() for rows in np.array_split(all_of(asked), 4)]
    return judged(np.concatenate(parts), held.visible != SAFE)


def has_learned(known):
    return known.precision > BAR.precision and known.sides > BAR.sides and known.bits > BAR.bits


@pytest.mark.parametrize(
    "part, seed",
    [
        ("roll_out", 0),
        *(
            pytest.param(part, seed, marks=pytest.mark.proof)
            for part, seed in (("context", 0), *product(sorted(ALONE), (1, 2)))
        ),
    ],
)
def test_each_part_alone_learns_what_ends_badly(part, seed, streets):
    known = learned(part, seed, streets)
    assert has_learned(known), known


# --- planted faults, each in the real function ---


def _a_tick_late(monkeypatch):
    labels = dataset_module.mask_soon_unsafe_actions
    monkeypatch.setattr(dataset_module, "mask_soon_unsafe_actions", lambda *of: np.roll(labels(*of), 1, axis=0))


def _mirrored_in_part(monkeypatch, pictures_alone):
    """A mirror in which either the pictures turn and nothing else does, or everything else does."""
    batch = Dataset.batch

    def half(self, picks, mirror=False):
        plain, turned = batch(self, picks), batch(self, picks, mirror=mirror)
        pictures, rest = (turned, plain) if pictures_alone else (plain, turned)
        return replace(rest, inputs=(pictures.inputs[0], *rest.inputs[1:]))

    monkeypatch.setattr(Dataset, "batch", half)


def _pictures_alone(monkeypatch):
    _mirrored_in_part(monkeypatch, True)


def _all_but_pictures(monkeypatch):
    _mirrored_in_part(monkeypatch, False)


def _upside_down(monkeypatch):
    """The sign is wrong: what is safe counts as unsafe."""
    labels = dataset_module.mask_soon_unsafe_actions
    monkeypatch.setattr(dataset_module, "mask_soon_unsafe_actions", lambda *of: ~labels(*of))


@pytest.mark.proof
@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize(
    "fault, part",
    [
        (_a_tick_late, "roll_out"),
        (_pictures_alone, "roll_out"),
        (_all_but_pictures, "roll_out"),
        (_pictures_alone, "context"),
        (_all_but_pictures, "context"),
        (_upside_down, "roll_out"),
    ],
)
def test_a_planted_fault_is_found_out(fault, part, seed, streets, monkeypatch):
    """Precision, sides and bits, by seeds 0, 1, 2; the bar is 0.87, 0.92, 0.6, and all three have to be above it.

    Sound: `roll_out` 0.91 0.97 0.67, 0.93 0.98 0.70, 0.92 0.97 0.69; `context` 0.91 0.98 0.69, 0.91 0.98 0.68,
    0.91 0.98 0.69.
    A tick late: `roll_out` 0.42 0.40 0.16, 0.44 0.48 0.14, 0.43 0.48 0.15.
    Pictures alone turned: `roll_out` 0.81 0.87 0.51, 0.83 0.90 0.55, 0.81 0.89 0.50. All but them: 0.80 0.85 0.51,
    0.83 0.94 0.54, 0.82 0.89 0.55. `context`, the first with seeds 0 and 2, the second with 1: 0.80 0.64 0.55,
    0.80 0.55 0.54, 0.79 0.66 0.53.
    Upside down: `roll_out` 0.09 0.13 -10.7, 0.09 0.25 -5.9, 0.09 0.29 -5.1.
    """
    fault(monkeypatch)
    known = learned(part, seed, streets)
    assert not has_learned(known), known


# --- closed loop ---

RIDE = ("danger.batch=16", "danger.learning_rate=0.005")
RIDE_UPDATES = 600


@pytest.fixture(scope="module")
def rides():
    """50 rides to learn from, driven by a mixture, and 20 of the user alone in other streets."""
    config = toy_config(*RIDE)
    return ride(config, mixed, 50, seed=1, labelled=True), ride(config, follow, 20, seed=99)


def driven(seed, rides):
    """20 rides of a network that has learned, in the streets of the user alone."""
    config = toy_config(*RIDE)
    learner = DangerLearner(config, seed, RIDE_UPDATES)
    learner.learn(lessons_of(config, segment_of(rides[0].rows), seed), RIDE_UPDATES)
    return ride(config, DangerPolicy("toy", learner.net, config, DangerRuleSettings(threshold=0.15)), 20, seed=99)


def drives_well(mine, alone):
    """Far fewer crashes than the user alone, who is still followed, and no chair that stands still."""
    return (
        1000 * mine.crashes / mine.steps <= 0.4 * 1000 * alone.crashes / alone.steps
        and mine.joystick_distance <= 0.6
        and mine.way_m / mine.steps >= 0.3 * alone.way_m / alone.steps
    )


@pytest.mark.proof
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_rule_with_a_network_that_has_learned_crashes_less_than_the_user_alone(seed, rides):
    mine, alone = driven(seed, rides), rides[1]
    assert alone.crashes >= 12 and alone.joystick_distance < 0.1768
    assert drives_well(mine, alone), (mine.crashes, mine.steps, mine.joystick_distance, mine.way_m)


@pytest.mark.proof
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_network_that_learned_the_opposite_does_not_drive(seed, rides, monkeypatch):
    """19 or 20 crashes in 421 to 447 steps; follow has 18 in 567, what learned rightly 5 or 6 in 1052 to 1115."""
    _upside_down(monkeypatch)
    mine = driven(seed, rides)
    assert not drives_well(mine, rides[1]), (mine.crashes, mine.steps, mine.joystick_distance, mine.way_m)
