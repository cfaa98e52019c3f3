"""PyBullet, loaded without the line about its build time; others import it from here."""

from typing import Any

from wcsim.core.processes import drop_stderr_lines
from wcsim.errors import PhysicsError

__all__ = ["Bullet", "pybullet"]

with drop_stderr_lines(b"pybullet build time:"):
    import pybullet


class Bullet:
    """One world of PyBullet without a window: the functions of `pybullet` act in this world."""

    def __init__(self) -> None:
        """Raises PhysicsError when PyBullet has no free client."""
        self.number: int = pybullet.connect(pybullet.DIRECT)
        if self.number < 0:
            raise PhysicsError(
                "PyBullet has no free client; expected one: close other engines of this process "
                "first"
            )

    def close(self) -> None:
        """End the world; a second call does nothing."""
        if self.number >= 0:
            pybullet.disconnect(self.number)
            # The stored functions have a number that the next world may get.
            vars(self).clear()
            self.number = -1

    def __getattr__(self, name: str) -> Any:
        native, number = getattr(pybullet, name), self.number

        # Not `functools.partial`: a profile would not show the native function behind it.
        def function(*given: Any, **named: Any) -> Any:
            return native(*given, physicsClientId=number, **named)

        # From the second call on it is found without this method.
        self.__dict__[name] = function
        return function
