"""A base class for what holds a handle and is used with `with`."""

from abc import ABC, abstractmethod
from typing import Self


class ClosingContextBase(ABC):
    """A context manager that calls `close` at its end, also after an error."""

    @abstractmethod
    def close(self) -> None:
        """Release what is held; a second call does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()
