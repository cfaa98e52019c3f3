"""Questions to pictures: each is asked, its mark is drawn, and an answer is judged as the page of the test says."""

import json

import cv2
import pytest

from benchmarks.__main__ import main
from benchmarks.sight.items import ASKED, items_of


def test_every_question_is_asked_of_a_street_the_same_way_each_time(corner_town):
    items, again = (list(items_of(corner_town, 1, 3)) for _ in range(2))
    assert {"surface", "speed", "place"} <= {item.question for item in items} <= set(ASKED)
    assert all((a.picture == b.picture).all() and a.truth == b.truth for a, b in zip(items, again, strict=True))
    truths = {item.question: item.truth for item in items}
    assert truths["place"] in "ABCDE" and truths.get("kerb", "A") in "AB"
    assert 3.0 < float(truths.get("distance", 4.0)) < 25.0 and 0.3 < float(truths["speed"]) < 2.0


@pytest.mark.parametrize("question, truth, right, wrong", [
    ("kerb", "A", "a", "B"), ("distance", "10.0", "11.9", "12.1"), ("speed", "1.00", "0.85", "1.3"),
])  # fmt: skip
def test_answers_are_counted(tmp_path, capsys, question, truth, right, wrong):
    key = {name: {"question": question, "truth": truth, "town": "x"} for name in ("0001", "0002")}
    (tmp_path / "key.json").write_text(json.dumps(key))
    answers = tmp_path / "answers.csv"
    answers.write_text(f"picture,answer\n0001,{right}\n0002,{wrong}\n")
    assert main(["sight", "--out", str(tmp_path), "--answers", str(answers)]) == 0
    assert f"{question}: 1 of 2 (" in capsys.readouterr().out
    answers.write_text(f"picture,answer\n0001,{right}\n")
    assert main(["sight", "--out", str(tmp_path), "--answers", str(answers)]) == 2


def test_pictures_questions_and_truth_are_written(corner, tmp_path, capsys):
    assert main(["sight", "--towns", str(corner), "--each", "1", "--out", str(tmp_path), "--seed", "3"]) == 0
    key = json.loads((tmp_path / "key.json").read_text())
    asked = (tmp_path / "questions.txt").read_text()
    for name, said in key.items():
        assert f"{name}: {ASKED[said['question']]}" in asked
        assert cv2.imread(str(tmp_path / f"{name}.png")).shape == (450, 800, 3)
