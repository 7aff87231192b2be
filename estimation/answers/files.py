"""Answers about files: recordings, exports, bench measurements and aircraft files."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from estimation.answers.answer import Answer, Rows, panels


@dataclass(frozen=True, repr=False)
class FileAnswer(Answer):
    """The answer of a verb about files. content: its --json; sentences: the printed lines; sound: False where a check failed."""

    content: Any
    sentences: tuple[str, ...]
    sound: bool = True

    @property
    def passed(self) -> bool:
        """Whether the file is sound, where the verb checks that."""
        return self.sound

    def to_json(self) -> Any:
        return self.content

    def lines(self) -> tuple[str, ...]:
        return self.sentences

    def headline(self) -> str:
        return self.sentences[0]

    def numbers(self) -> dict[str, int]:
        """Number of samples of each channel; for a check, its counts; for a list, its length."""
        if not isinstance(self.content, Mapping):
            return {"count": len(self.content)}
        if "channels" in self.content:
            return {c["name"]: c["samples"] for c in self.content["channels"]}
        return {n: v for n, v in self.content.items() if isinstance(v, int) and not isinstance(v, bool)}

    def rows(self) -> Rows:
        return ("", "number"), [(n, str(v)) for n, v in self.numbers().items()]

    def plot(self, ax: Any = None) -> Any:
        return bars(self.numbers(), ax)


def bars(numbers: Mapping[str, int], ax: Any) -> Any:
    """Draw a bar for each number on the given axes, or on new ones; returns the axes."""
    (axes,) = panels(ax, 1, (7.0, 0.6 + 0.22 * len(numbers)))
    axes.barh(list(numbers), list(numbers.values()))
    axes.invert_yaxis()
    return axes
