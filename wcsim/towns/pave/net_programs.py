"""The author's signal programs that lie in the net itself: netconvert puts phases of its own into them."""

from __future__ import annotations

from xml.etree.ElementTree import Element

from wcsim.towns.pave.elements import Paving, edits_of


def keep_programs(before: Element, after: Element, paving: Paving) -> bool:
    """Put the programs of a net in the place of those that netconvert made of them, with the new crossings' letters.

    Args:
        before: The author's net; its programs are changed as those of an additional file are.
        after: The net with crossings; is changed.
        paving: What is known of both; counts the programs.

    Returns:
        Whether there is any.
    """
    programs = Element("additional")
    programs.extend(logic for logic in before.iterfind("tlLogic") if logic.get("id") in paving.signals)
    elements = list(programs.iter())
    for number, changes in edits_of(programs, paving, in_net=True).items():
        elements[number].attrib.update(changes)
    theirs = {logic.get("id") for logic in programs}
    made = [logic for logic in after.iterfind("tlLogic") if logic.get("id") in theirs]
    if not made:
        return False
    place = list(after).index(made[0])
    for logic in made:
        after.remove(logic)
    after[place:place] = list(programs)
    return True
