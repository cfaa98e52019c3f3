"""What counts as a stick in Chromium: keys, pointers, gamepads, and how each of them is let go of."""

from collections.abc import Callable

import pytest

from tests.drive.page.stage import IN_CHROMIUM, REST, Stage, touches

pytestmark = [*IN_CHROMIUM, pytest.mark.timeout(900)]
AHEAD = {(0.0, 1.0)}
STILL = {REST}
HELD_MS = 400  # a shorter press of "overrule" goes on


def leave(stage: Stage) -> None:
    for event in ("blur", "focus"):
        stage.page.evaluate("(name) => window.dispatchEvent(new Event(name))", event)
    assert stage.sticks() == STILL


def crash(stage: Stage) -> None:
    stage.state(speed_mps=1.04)
    stage.state(crash="drove into a car")
    assert (
        stage.text("#live")
        == stage.text("#big")
        == "You hit a car at 1.0 m/s. You start again a little before that place."
    )
    stage.state(tick=2)


STOPS: dict[str, Callable[[Stage], None]] = {
    "stop": lambda stage: stage.page.click("#stop"),
    "escape": lambda stage: stage.page.keyboard.press("Escape"),
    "crash": crash,
    "left": leave,
}


@pytest.mark.parametrize("how", STOPS)
def test_a_held_key_counts_only_once_it_has_been_let_go_of(stage: Stage, how: str) -> None:
    keyboard = stage.page.keyboard
    keyboard.down("ArrowUp")
    assert stage.sticks() == AHEAD
    STOPS[how](stage)
    for _ in range(3):
        keyboard.down("ArrowUp")  # repeats by itself
        assert stage.sticks() == STILL
    if how != "left":
        stage.state(tick=3)
        assert stage.text("#big") == stage.text("#live") == "Release the stick first."
    keyboard.up("ArrowUp")
    assert stage.sticks() == STILL
    keyboard.down("ArrowUp")
    assert stage.sticks() == AHEAD


@pytest.mark.parametrize("how", [how for how in STOPS if how != "stop"])  # a mouse would take the finger away
def test_a_finger_counts_only_once_it_has_been_let_go_of(stage: Stage, how: str) -> None:
    touch = touches(stage.page)
    touch("touchStart", 0.0)
    touch("touchMove", 0.6)
    assert max(y for _, y in stage.sticks()) > 0.5
    STOPS[how](stage)
    for ahead in (0.61, 0.7, 0.5):
        touch("touchMove", ahead)
        assert stage.sticks() == STILL
    touch("touchEnd", 0.0)
    assert stage.sticks() == STILL
    touch("touchStart", 0.0)
    touch("touchMove", 0.6)
    assert max(y for _, y in stage.sticks()) > 0.5
    touch("touchEnd", 0.0)


def test_a_key_that_is_released_elsewhere_is_released(stage: Stage) -> None:
    keyboard = stage.page.keyboard

    def ahead() -> None:
        stage.page.focus("#steering")
        keyboard.down("ArrowUp")
        assert stage.sticks() == AHEAD

    for elsewhere in ("#level", "#user"):
        ahead()
        stage.page.focus(elsewhere)
        keyboard.up("ArrowUp")
        assert stage.sticks() == STILL
    ahead()
    keyboard.down("Control")
    keyboard.up("ArrowUp")
    keyboard.up("Control")
    assert stage.sticks() == STILL
    ahead()
    stage.page.focus("#level")
    keyboard.press("Space")
    assert stage.sticks() == STILL


def test_two_keys_that_cancel_out_are_not_let_go_of(stage: Stage) -> None:
    keyboard = stage.page.keyboard
    for key in ("ArrowUp", "ArrowDown"):
        keyboard.down(key)
    keyboard.press("Escape")
    assert stage.sticks() == STILL
    keyboard.up("ArrowDown")
    assert stage.sticks() == STILL


def test_a_mouse_drives_by_its_first_button_alone(stage: Stage) -> None:
    mouse, box = stage.page.mouse, stage.page.locator("#stick svg").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + 0.15 * box["height"]
    mouse.move(x, y)
    for button in ("right", "middle"):
        mouse.down(button=button)
        mouse.move(x + 2, y)
        assert stage.sticks() == STILL
        mouse.up(button=button)
    mouse.down()
    assert stage.sticks() != STILL
    mouse.down(button="right")
    mouse.up()
    mouse.move(x, y + 1)
    assert stage.sticks() == STILL, "the first button was released, and no pointer that one still holds up"
    mouse.up(button="right")
    menu = "(id) => document.querySelector(id).dispatchEvent(new Event('contextmenu', { cancelable: true }))"
    assert [stage.page.evaluate(menu, place) for place in ("#stick svg", "#overrule")] == [False, False]


def test_a_mac_that_hides_releases_leaves_no_key_pressed(stage: Stage) -> None:
    keyboard = stage.page.keyboard
    keyboard.down("ArrowUp")
    keyboard.down("o")
    assert stage.sticks() == AHEAD and stage.overrules()
    keyboard.down("Meta")
    keyboard.up("Meta")  # the others were released meanwhile, without a word
    assert stage.sticks() == STILL and not stage.overrules()
    stage.page.evaluate("window.dispatchEvent(new KeyboardEvent('keydown', { code: 'ArrowUp' }))")
    assert stage.sticks() == AHEAD, "a new press counts"


def test_overruling_ends_with_its_key_whatever_else_is_pressed(stage: Stage) -> None:
    keyboard = stage.page.keyboard
    stage.page.focus("#overrule")
    for key in ("Space", "Enter"):
        keyboard.down(key)
        assert stage.overrules()
        keyboard.down("Control")
        stage.page.wait_for_timeout(HELD_MS)
        keyboard.up(key)
        assert not stage.overrules()
        keyboard.up("Control")
    stage.page.click("#overrule", button="right")
    assert not stage.overrules()
    stage.page.hover("#overrule")
    stage.page.mouse.down()
    assert stage.overrules()
    stage.page.wait_for_timeout(HELD_MS)
    stage.page.mouse.up()
    assert not stage.overrules()


def test_a_screen_reader_switches_overruling_by_its_press(stage: Stage) -> None:
    for on in (True, False):
        stage.page.evaluate("document.getElementById('overrule').click()")
        assert stage.overrules() is on
        assert stage.page.get_attribute("#overrule", "aria-pressed") == str(on).lower()


def test_of_several_gamepads_the_one_that_is_pushed_counts(stage: Stage) -> None:
    pads = [None, *({"id": name, "connected": True, "axes": [0.0, 0.0], "buttons": []} for name in ("idle", "held"))]
    stage.page.evaluate("(pads) => { window.pads = pads; }", pads)
    stage.until(lambda: stage.text("#pad") == "Gamepad: idle, held")
    stage.page.evaluate("window.pads[2].axes = [0, -1]")
    assert stage.sticks() == AHEAD
    stage.page.evaluate("window.pads = []")
    assert stage.sticks() == STILL and "unplugged" in stage.text("#pad")


def test_a_device_that_rests_at_an_end_blocks_nothing(stage: Stage) -> None:
    axes = ([0.0, -1.0], [0.0, 0.0])
    pads = [{"id": "usb", "connected": True, "axes": each, "buttons": []} for each in axes]
    stage.page.evaluate("(pads) => { window.pads = pads; }", pads)
    assert stage.sticks() == STILL, "pedals"
    stage.page.evaluate("window.pads[1].axes = [0, -1]")
    assert stage.sticks() == AHEAD
    stage.page.evaluate("window.pads[1] = null")
    assert stage.sticks() == STILL
    assert stage.text("#pad") == stage.text("#live") == "Gamepad unplugged. The chair stops."
    stage.page.evaluate("window.pads[0].axes = [0, 0]")
    assert stage.sticks() == STILL
    stage.page.evaluate("window.pads[0].axes = [0, -1]")
    assert stage.sticks() == AHEAD, "it was in its middle"


def test_the_shortest_press_overrules_for_seconds_and_another_one_ends_that(stage: Stage) -> None:
    stage.heard("stick")
    press = "for (const kind of ['keydown', 'keyup']) window.dispatchEvent(new KeyboardEvent(kind, { code: 'KeyO' }))"
    for on in (True, False):
        stage.page.evaluate(press)
        assert stage.overrules() is on
        assert stage.text("#overrule-told").startswith("Overrules for " if on else "Overrule")
    stage.page.evaluate(press)
    stage.page.wait_for_timeout(2 * HELD_MS)
    assert stage.overrules(), "it goes on"


def test_a_gamepads_buttons_help_overrule_and_pause(stage: Stage) -> None:
    def push(*down: int) -> None:
        buttons = [{"pressed": number in down} for number in range(10)]
        stage.page.evaluate("pads => { window.pads = pads; }", [{"id": "a", "axes": [0, 0], "buttons": buttons}])

    push()
    stage.heard("stick")
    push(0)
    stage.until(lambda: {"say": "help"} in stage.said)
    push(1)
    stage.until(stage.overrules)
    push(9)
    stage.until(lambda: {"say": "pause", "on": True} in stage.said)


def test_the_lamp_counts_down_while_help_is_on(stage: Stage) -> None:
    for help_s, assisted, told in ((9.9, True, "helps for 10 s"), (0.1, True, "helps for 1 s"), (0.0, True, "on")):
        stage.state(help_s=help_s, assisted=assisted)
        assert stage.text("#lamp-assist span") == told
    stage.state(help_s=5.0, overruled=True)
    assert stage.text("#lamp-assist span") == "overruled"


def test_a_call_for_help_that_nobody_hears_is_not_told_as_one(stage: Stage) -> None:
    stage.page.click("#help")
    assert stage.text("#live") == "You asked for help." and len(stage.heard("help")) == 1
    stage.role(drives=False)
    stage.page.keyboard.press("h")
    assert stage.text("#live") == stage.text("#notice") == "Help was not sent: this page only watches."
    assert stage.heard("help") == []


def test_why_the_chair_does_not_go_is_said_aloud(stage: Stage) -> None:
    for changes, told in (
        ({"paused": True}, "Paused"),
        ({}, "Resumed."),
        ({"waiting": "No page is driving. Time is paused."}, "No page is driving. Time is paused."),
    ):
        stage.state(**changes)
        assert stage.text("#live") == told


def test_a_page_that_was_left_says_so(stage: Stage) -> None:
    assert not stage.away()
    stage.page.evaluate("window.dispatchEvent(new Event('blur'))")
    assert stage.away()
    stage.page.evaluate("window.dispatchEvent(new Event('focus'))")
    assert not stage.away()


def test_who_drives_goes_on_when_another_page_comes(stage: Stage) -> None:
    stage.page.keyboard.down("ArrowUp")
    assert stage.sticks() == AHEAD
    stage.role(drives=True)
    assert stage.sticks() == AHEAD
