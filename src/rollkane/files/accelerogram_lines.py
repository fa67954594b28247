"""The lines of a record's file, the numbers in them, and how they are refused."""

import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import NoReturn

import numpy as np

from ..validation.checks import FieldError

NUMBER = re.compile(
    r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eEdD][-+]?\d+)?$", re.ASCII | re.IGNORECASE
)
# two signs of a comma that stands for a decimal point: digits around it, and another
# separator that has no comma beside it
_COMMA = re.compile(r"\d,\d")
_OTHER = re.compile(r"[^,;\s](?:\s*;\s*|\s+)[^,;\s]")
_SEPARATORS = re.compile(r"[\s,;]+")
# fewer characters than these are not a printed format that all samples share
_PRINTED_WIDTH = 5
# of numbers without trailing zeros a tenth is shorter than the others: that so many
# are not, and the next one is, happens once in 2000 whole files
MANY_ALIKE = 50


class Lines:
    """The lines of a file, counted from 0; messages count from 1."""

    def __init__(self, reader: str, path: str | os.PathLike[str]):
        """Read a text file.

        Args:
            reader: Name of the function that reads, for the messages.
            path: The file.

        Raises:
            FieldError: it cannot be read, or is no text.
        """
        self.reader, self.path = reader, str(path)
        self.lines: list[str] = []
        try:
            raw = Path(path).read_bytes()
        except OSError as error:
            self.refuse(None, f"cannot be read: {error.strerror}", "give a file's path")
        except (TypeError, ValueError) as error:
            raise FieldError(
                f"{reader}.path", path, "is not a path", "give a file's path"
            ) from error
        if b"\0" in raw:
            self.refuse(None, "holds binary data", "give the text file of the record")
        try:
            # a byte order mark would make a header of the first row
            text = raw.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = raw.decode("latin-1")
        # PEER's files are about with \r\r\n, which is the end of one line
        self.lines = re.split(r"\r*\n|\r", text)
        self.ended = not self.lines[-1]
        if self.ended:
            del self.lines[-1]

    def refuse(self, line: int | None, problem: str, remedy: str) -> NoReturn:
        """Raise, naming the file and the line (None for the whole)."""
        where = "" if line is None else f", line {line + 1}"
        value = self.path
        if line is not None and line < len(self.lines):
            value = self.lines[line].strip()
        raise FieldError(
            f"{self.reader}.path", value, f"{self.path}{where}: {problem}", remedy
        )

    def numbers(self, words: list[str], line: int) -> list[float]:
        """Words of a line as finite numbers."""
        found: list[float] = []
        for word in words:
            if not NUMBER.match(word):
                self.refuse(line, f"holds {word!r}, not a number", "mend the line")
            value = float(word.replace("D", "E").replace("d", "e"))
            if not np.isfinite(value):
                self.refuse(line, f"holds {word}, which is too large", "mend the line")
            found.append(value)
        return found

    def whole(self, word: str, line: int) -> int:
        """A word of a line as a count."""
        (value,) = self.numbers([word], line)
        if value != int(value):
            problem = f"counts {word} samples, which is not a whole number"
            self.refuse(line, problem, "mend the count")
        return int(value)

    def words(self, line: int) -> list[str]:
        """Words of a line between blanks, commas and semicolons; [] of a blank one."""
        text = self.lines[line].strip().rstrip(",; \t")
        words = _SEPARATORS.split(text) if text else []
        mixed = _COMMA.search(text) and _OTHER.search(text)
        if mixed and all(NUMBER.match(word) for word in words):
            problem = "has decimal commas, or two kinds of separators"
            self.refuse(line, problem, "write decimal points, and one separator")
        return words

    def rest(self, start: int) -> Iterator[tuple[int, list[str]]]:
        """Words of every line that is not blank, from a line on."""
        for i in range(start, len(self.lines)):
            words = self.words(i)
            if words:
                yield i, words

    def column(self, start: int, count: int) -> np.ndarray:
        """All numbers from a line on; as many as the file's header says."""
        values: list[float] = []
        written: list[str] = []
        for i, words in self.rest(start):
            values += self.numbers(words, i)
            written += words
        if len(values) != count:
            problem = f"holds {len(values)} samples, and its header says {count}"
            self.refuse(None, problem, "mend the header, or get the whole file")
        self.check_end(written)
        return np.array(values)

    def check_end(self, written: list[str], least: int = 1) -> None:
        """Refuse a file that stops within its last number.

        What is left of a number is a number: ``.1520167E-02`` cut by one character is
        0.15. Samples that are all printed alike tell, where no line end follows.

        Args:
            written: Words of the samples, the last one that of the file's end.
            least: Of how many others samples are known to be printed alike at least.
        """
        *others, last = (word.strip().lstrip("+-") for word in written or [""])
        if self.ended or not last or len(others) < least:
            return
        widths = {len(word) for word in others}
        cut = len(widths) == 1 and len(last) < min(widths) >= _PRINTED_WIDTH
        if len(others) >= MANY_ALIKE:  # of any whole part, with as many decimals
            decimals = {_decimals(word) for word in others}
            cut |= len(decimals) == 1 and _decimals(last) < min(decimals)
        if cut:
            self.refuse(
                len(self.lines) - 1,
                f"ends within the number {last}, without a line end",
                "get the whole file, or end the line",
            )


def _decimals(word: str) -> int:
    """Characters behind a number's point, with those of its exponent."""
    return len(word.partition(".")[2])
