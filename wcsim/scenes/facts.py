"""What a scene came to, in numbers that its file can demand."""

from __future__ import annotations

from wcsim.config.scene import SceneExpect

ALONE_M = 99.0
"""The gap to others when there are none."""
FASTEST_MPS = 99.0
"""The slowest speed when no vehicle drives."""


Facts = dict[str, float]
"""What a scene came to, over all its seats, by the names of `SceneExpect`, which says what each is."""


def faults(facts: Facts, expect: SceneExpect) -> tuple[str, ...]:
    """Where what happened is not what the scene must show; empty when all is well."""
    found = []
    if expect.crashed is not None and facts["crashed"] != expect.crashed:
        found.append(f"crashed is {facts['crashed']}, expected {expect.crashed}")
    for name in SceneExpect.model_fields:
        window = getattr(expect, name)
        if isinstance(window, tuple) and not window[0] <= facts[name] <= window[1]:
            found.append(f"{name} is {facts[name]:.3f}, expected {window[0]:g} to {window[1]:g}")
    return tuple(found)
