"""What is closed at the end of a `with`."""

from __future__ import annotations

import abc
from typing import Self


class Closing(abc.ABC):
    """Something that `with` closes, however the block ends."""

    @abc.abstractmethod
    def close(self) -> None:
        """Give back what is held."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
