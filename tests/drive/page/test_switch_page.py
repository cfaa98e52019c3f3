"""One to four switches in Chromium: what is highlighted, what is held, and what they reach."""

from collections.abc import Callable

import pytest

from tests.drive.page.stage import ABOUT, IN_CHROMIUM, REST, Stage, axe_finds_nothing
from tests.drive.page.test_stick_page import AHEAD, STILL, crash, leave
from wcsim.drive.recording.study_plan import StepKind

pytestmark = [*IN_CHROMIUM, pytest.mark.timeout(900)]
LEFT, RIGHT = {(-0.5, 0.0)}, {(0.5, 0.0)}
HERE = "#board [data-at]"


def switches(stage: Stage, count: int) -> None:
    stage.page.select_option("#steer-by", str(count))


def highlighted(stage: Stage) -> tuple[str, str]:
    """The choice, and whether it drives."""
    return stage.text(HERE), str(stage.page.get_attribute(HERE, "data-at"))


def move_to(stage: Stage, name: str) -> None:
    """Press the second of two switches until this is highlighted."""
    for _ in range(20):
        if highlighted(stage)[0] == name:
            return
        stage.page.keyboard.press("b")
    raise AssertionError(name)


def lose(stage: Stage) -> None:
    stage.page.evaluate("window.dispatchEvent(new Event('gamepaddisconnected'))")


LOSSES: dict[str, Callable[[Stage], None]] = {"left": leave, "crash": crash, "unplugged": lose}


@pytest.mark.parametrize("how", LOSSES)
def test_after_a_loss_the_highlighted_choice_is_the_one_that_is_picked(stage: Stage, how: str) -> None:
    switches(stage, 2)
    move_to(stage, "Overrule")
    stage.page.keyboard.press("Enter")
    assert stage.page.locator("#board [data-on=true]").text_content() == "Overrule"
    move_to(stage, "Back")
    stage.page.keyboard.press("Enter")
    assert highlighted(stage) == ("Back", "drives") and stage.sticks() == {(0.0, -0.5)}
    LOSSES[how](stage)
    assert highlighted(stage) == ("Ahead", "here") and stage.sticks() == STILL
    assert stage.page.locator("#board [data-on=true]").count() == int(how == "crash"), "a crash takes nothing away"
    stage.page.keyboard.press("b")
    assert highlighted(stage) == ("Slowly ahead", "here") and stage.sticks() == STILL
    stage.page.keyboard.press("Enter")
    assert stage.sticks() == {(0.0, 0.5)}


@pytest.mark.parametrize("how", ["escape", *LOSSES])
def test_a_held_switch_counts_only_once_it_has_been_let_go_of(stage: Stage, how: str) -> None:
    switches(stage, 3)
    keyboard = stage.page.keyboard
    keyboard.down("2")
    assert stage.sticks() == AHEAD
    if how == "escape":
        keyboard.press("Escape")
    else:
        LOSSES[how](stage)
    for _ in range(3):
        keyboard.down("2")  # repeats by itself
        assert stage.sticks() == STILL
    keyboard.down("1")
    assert stage.sticks() == LEFT, "another one is a new press"
    keyboard.up("1")
    assert stage.sticks() == STILL
    keyboard.up("2")
    keyboard.down("2")
    assert stage.sticks() == AHEAD


def test_of_held_switches_the_newest_counts_and_what_is_left_goes_on(stage: Stage) -> None:
    switches(stage, 4)
    keyboard = stage.page.keyboard
    for key, told in (("2", AHEAD), ("1", LEFT)):
        keyboard.down(key)
        assert stage.sticks() == told
    keyboard.up("1")
    assert stage.sticks() == AHEAD
    keyboard.up("2")
    keyboard.down("1")
    keyboard.down("3")
    keyboard.up("1")
    assert stage.sticks() == RIGHT
    keyboard.up("3")
    assert stage.sticks() == STILL


def test_three_switches_ask_for_help_overrule_and_pause(stage: Stage) -> None:
    switches(stage, 3)
    keyboard = stage.page.keyboard
    for on, said in ((0, "help"), (1, "stick"), (2, "pause"), (3, "")):
        for key in ("1", "3"):
            keyboard.down(key)
        assert stage.sticks() == {REST}
        stage.page.wait_for_selector("#board button:has-text('Back to driving')")
        for key in ("1", "3"):
            keyboard.up(key)
        stage.said.clear()
        for _ in range(on):
            keyboard.press("3")
        keyboard.press("2")
        assert not said or stage.heard(said)
        assert stage.overrules() is (on > 0), "until it is picked again"
        assert stage.text("#board") == "1 Left2 Ahead3 Right"


def test_one_switch_drives_again_after_the_page_was_opened_again(stage: Stage) -> None:
    switches(stage, 1)
    stage.page.fill("#scan-s", "6")
    stage.page.dispatch_event("#scan-s", "change")
    stage.open()
    assert stage.page.input_value("#scan-s") == "6" and stage.page.is_visible("#scan-label")
    stage.page.keyboard.press("b")
    assert stage.sticks() == AHEAD and highlighted(stage) == ("Ahead", "drives")
    stage.page.evaluate("localStorage.setItem('wcsim-steer-by', 'nothing of the kind')")
    stage.open()
    assert stage.page.input_value("#steer-by") == "stick"


def test_what_one_participant_of_a_study_steers_with_is_not_the_next_ones(stage: Stage) -> None:
    def meet(participant: int) -> str:
        view = {"step": 0, "kind": StepKind.READ, "participant": participant, "title": "Alone", "told": [], "where": ""}
        more = {"wait_s": 0.0, "left_s": None, "arrivals_left": None, "questions": [], "trouble": ""}
        stage.hear("study", view={**view, **more, "button": "Start driving", "ready": True})
        stage.catch_up()
        assert stage.text("#study-number") == f"Participant {participant}"
        assert stage.page.input_value("#study-steer") == stage.page.input_value("#steer-by")
        return str(stage.page.input_value("#steer-by"))

    switches(stage, 3)
    assert meet(1) == "stick", "chosen before the study"
    stage.page.select_option("#study-steer", "2")
    stage.open()
    assert meet(1) == "2", "a page that is opened again"
    assert meet(2) == "stick", "a page that stays"
    stage.open()
    assert meet(2) == "stick"


@pytest.mark.parametrize("count, key", [(1, "b"), (2, "Enter"), (3, "2"), (4, "2")])
def test_switches_take_over_from_another_page(stage: Stage, count: int, key: str) -> None:
    switches(stage, count)
    stage.role(drives=False)
    assert highlighted(stage) == ("Take control", "here")
    stage.page.keyboard.press(key)
    assert stage.heard("takeover")
    stage.role(drives=True)
    stage.page.keyboard.down(key)
    assert stage.sticks() == AHEAD


def test_two_switches_pause_and_go_on(stage: Stage) -> None:
    switches(stage, 2)
    for on in (True, False):
        move_to(stage, "Pause / resume")
        stage.page.keyboard.press("Enter")
        assert [said["on"] for said in stage.heard("pause")] == [on]
        stage.state(paused=on)


def test_axe_finds_nothing_whatever_one_steers_by(stage: Stage) -> None:
    """A real drive goes on meanwhile, which costs ten times as much: a proof asks it."""
    for by in ("stick", "1"):
        stage.page.select_option("#steer-by", by)
        axe_finds_nothing(stage.page)


def test_choices_that_would_end_badly_are_marked(stage: Stage) -> None:
    stage.hear("about", **{**ABOUT, "points": [(0.0, 1.0), (0.0, 0.0), (0.0, -0.5)]})
    stage.page.select_option("#steer-by", "1")
    stage.state(unsafe=[0])
    marked = stage.page.eval_on_selector_all(
        "#board [data-unsafe=true]", "nodes => nodes.map(node => node.textContent)"
    )
    assert "Ahead: unsafe" in marked and "Back: unsafe" not in marked
    stage.state(unsafe=[])
    assert stage.page.locator("#board [data-unsafe=true]").count() == 0
