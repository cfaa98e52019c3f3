"""People on foot on a pavement so narrow that nobody can step aside."""

from __future__ import annotations

import numpy as np

from wcsim.towns.scene_folders.families.draft import FORE_M, Draft, Push, way_of
from wcsim.towns.scene_folders.families.scene_streets import END_M, WALKER, Pavement, row, street


def oncoming_pair(rng: np.random.Generator) -> Draft:
    """Two people abreast come towards the chair, and fill the pavement with it."""
    pavement = Pavement(width_m=float(rng.uniform(1.7, 2.1)))
    start_m = (-20.0, pavement.at(0.5 * pavement.width_m + float(rng.uniform(-0.1, 0.1))))
    stick = (Push(0.4, 0.0, float(rng.choice((0.5, 0.75)))),)
    pace_mps, meet_s = float(rng.uniform(0.9, 1.4)), float(rng.uniform(4.0, 7.0))
    meet_m = float(way_of(start_m, 90.0, stick, meet_s)[-1, 1]) + FORE_M
    begin_m = meet_m + pace_mps * meet_s + END_M
    people = "\n".join(
        f'<person id="{name}" type="walker" depart="0" departPos="{begin_m + back_m:.2f}">'
        f'<walk edges="WE" arrivalPos="2" departPosLat="{left_m}"/></person>'
        for name, back_m, left_m in (("left", 0.0, 0.4), ("right", float(rng.uniform(0.0, 0.5)), -0.4))
    )
    return Draft(
        shows="Two people walk abreast towards a wheelchair on a pavement that is too narrow for the three.",
        routes=f"{WALKER.format(pace_mps)}\n{people}",
        place=street(pavement, row(pavement)),
        start_m=start_m,
        goal_m=(45.0, start_m[1]),
        stick=stick,
        duration_s=meet_s + 8.0,
        attention_share=1.0,
    )


def person_turns_round(rng: np.random.Generator) -> Draft:
    """Somebody walks in front of the chair and turns round, or stops dead."""
    pavement = Pavement(width_m=float(rng.uniform(1.35, 1.6)))
    start_m = (-20.0, pavement.at(0.5 * pavement.width_m + float(rng.uniform(-0.1, 0.1))))
    stick = (Push(0.4, 0.0, 0.75),)
    pace_mps, turn_s = float(rng.uniform(0.6, 0.9)), float(rng.uniform(4.0, 7.0))
    chair_m = float(way_of(start_m, 90.0, stick, turn_s)[-1, 1]) + FORE_M
    turn_m = chair_m + float(rng.uniform(0.5, 0.9)) + END_M
    begin_m = turn_m - 0.95 * pace_mps * turn_s
    stop = f'<stop lane="WE_0" startPos="{turn_m - 0.2:.2f}" endPos="{turn_m + 0.2:.2f}" duration="6"/>'
    after = '<walk edges="WE" arrivalPos="2"/>' if rng.random() < 0.6 else f'{stop}<walk edges="WE"/>'
    person = (
        f'<person id="walker" type="walker" depart="0" departPos="{begin_m:.2f}">'
        f'<walk edges="WE" arrivalPos="{turn_m:.2f}"/>{after}</person>'
    )
    return Draft(
        shows="Somebody walks in front of a wheelchair on a narrow pavement and turns round, or stops dead.",
        routes=f"{WALKER.format(pace_mps)}\n{person}",
        place=street(pavement, row(pavement)),
        start_m=start_m,
        goal_m=(45.0, start_m[1]),
        stick=stick,
        duration_s=turn_s + 8.0,
        attention_share=1.0,
    )
