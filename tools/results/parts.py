"""Runs behind the tables about learning: parts of at most 90 minutes on two cores, each a few commands."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from wcsim.agents.runs.run_folder import MANIFEST, open_run

SEEDS: Final = (1, 2, 3)
BASELINES: Final = ("follow", "dwa", "oracle-visible", "oracle", "stop", "zero", "random")
PAPER_STEPS: Final = 14_000  # what two cores do in 25 minutes, at some ten steps a second
# What each ablation changes of preset `laptop`. These learn from the driving of `laptop-1`, all at once, as `again`
# does, their row of comparison.
OF_THE_NETWORK: Final[dict[str, tuple[str, ...]]] = {
    "again": (),
    "all-knowing-teacher": ("danger.teacher=truth",),
}
# These change the driving itself, in three of the five rounds: `three-rounds` is their row of comparison.
OF_THE_DRIVING: Final[dict[str, tuple[str, ...]]] = {
    "three-rounds": (),
    "no-own-driving": ("collect.network_share=0.0",),
    "no-delay": ("world.action_delay_ticks=0", "collect.variants=[]"),
    "no-variants": ("collect.variants=[]",),
    "no-noise": ("cameras.0.noise=none", "collect.variants=[]"),  # its row of comparison is `no-variants`
    "one-town": ("collect.made_towns=0",),
    "25-towns": ("collect.made_towns=24",),
    "no-scenes": ("collect.scene_share=0.0",),
}
# Half of the updates that the rounds have.
ALL_AT_ONCE: Final = ("collect.rounds=1", "collect.segments=0", "danger.updates=2500")
FEWER_ROUNDS: Final = ("collect.rounds=3",)


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """A command of `wcsim`, and what it makes; in a folder that is there already it goes on with other words."""

    words: tuple[str, ...]
    again: tuple[str, ...]
    folder: Path
    makes: Path  # of a run its manifest

    @property
    def is_made(self) -> bool:
        """Whether it is done; a training that was stopped leaves a policy as well, so its manifest says that."""
        is_run = self.makes.name == MANIFEST
        return self.makes.is_file() and (not is_run or open_run(self.folder).manifest.status == "done")


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """Commands that are run one after the other."""

    name: str
    says: str
    steps: tuple[Step, ...]


def parts(out: Path) -> list[Part]:
    """All parts, in an order in which each finds what it needs.

    Args:
        out: The folder of everything that is made.
    """
    found = [Part(name="baselines", says="all baselines on suite dev2", steps=(judged(out, ()),))]
    found += [
        Part(name=f"laptop-{seed}", says=f"preset laptop, seed {seed}", steps=(trained(out, f"laptop-{seed}", seed),))
        for seed in SEEDS
    ]
    runs = tuple(f"laptop-{seed}" for seed in SEEDS)
    paper = trained(out, "paper-1", 1, "paper", (f"learn.total_steps={PAPER_STEPS}",))
    told = f"preset paper, {PAPER_STEPS:,} steps (as long as preset laptop takes), on suite dev2"
    found.append(Part(name="paper", says=told, steps=(paper, judged(out, ("paper-1",)))))
    found.append(Part(name="dev2", says="these three networks on suite dev2", steps=(judged(out, runs),)))
    found += [_small(out, preset) for preset in ("quick", "dqn")]
    return found + list(_ablations(out))


def _small(out: Path, preset: str) -> Part:
    runs = tuple(f"{preset}-{seed}" for seed in SEEDS)
    steps = (*(trained(out, name, int(name[-1]), preset) for name in runs), judged(out, runs, alone=True))
    return Part(name=preset, says=f"preset {preset}, three seeds, on suite dev2", steps=steps)


def _ablations(out: Path) -> Iterator[Part]:
    first = trained(out, "laptop-1", 1)
    for name, settings in OF_THE_NETWORK.items():
        run = f"ablation-{name}"
        learned = trained(out, run, 1, settings=(*ALL_AT_ONCE, *settings), data=out / "laptop-1" / "data")
        steps = first, learned, judged(out, (run,), alone=True)
        yield Part(name=run, says=f"learn from the dataset of laptop-1, {_told(settings)}", steps=steps)
    for name, settings in OF_THE_DRIVING.items():
        run = f"ablation-{name}"
        steps = trained(out, run, 1, settings=(*FEWER_ROUNDS, *settings)), judged(out, (run,), alone=True)
        yield Part(name=run, says=f"preset laptop {_told((*FEWER_ROUNDS, *settings))}", steps=steps)


def _told(settings: tuple[str, ...]) -> str:
    return f"with {', '.join(settings)}" if settings else "in one round"


def trained(
    out: Path, name: str, seed: int, preset: str = "laptop", settings: tuple[str, ...] = (), data: Path | None = None
) -> Step:
    """A training run in Helsinki, or one that learns from a data folder."""
    run = out / name
    command = "train-q" if preset in ("dqn", "paper") else "train"
    words = (command, "--town", "helsinki", "--preset", preset, "--seed", str(seed), "--out", str(run), *_set(settings))
    words = (*words, "--data", str(data)) if data is not None else words
    again = ("resume", str(run))
    return Step(words=words, again=again, folder=run, makes=run / MANIFEST)


def judged(out: Path, runs: tuple[str, ...], alone: bool = False) -> Step:
    """A test of runs on suite dev2, beside all baselines or beside the user alone; kept blocks are not driven again."""
    name = "-".join(("dev2", *runs))
    policies = tuple(str(out / run) for run in runs) or BASELINES
    # One folder a suite: what it has kept of the baselines serves every test.
    folder = out / "judged" / "dev2"
    table = out / "tables" / f"{name}.json"
    words = ("test", *policies, "--suite", "dev2", "--jobs", "2", "--out", str(folder), *(("--only",) if alone else ()))
    words = (*words, "--json", str(table))
    return Step(words=words, again=(*words, "--resume"), folder=folder, makes=table)


def _set(settings: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(word for setting in settings for word in ("--set", setting))
