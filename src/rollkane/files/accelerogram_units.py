"""Units in the prose of a record's header: which are said, and which only mentioned.

A line *says* a unit where it introduces one ("in units of cm/s/s", "acceleration (g)",
"acc_g"), and *mentions* one behind a number ("PGA = 0.3 g"). What looks like a unit of
the samples and is not known is said, too, so that it can be refused, as is a unit with
a factor; an unknown word in brackets behind the quantity is mentioned.
"""

import re
from collections.abc import Iterator
from typing import NamedTuple

from .accelerogram_lines import NUMBER

STANDARD_GRAVITY = 9.80665  # m/s^2, by which records "in g" are scaled
# what one sample is worth [m/s^2], by the names that the argument `unit` takes
UNITS = {"g": STANDARD_GRAVITY, "m/s2": 1.0, "cm/s2": 1e-2, "mm/s2": 1e-3}
# units of time in headers [s]
TIMES = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), 1.0),
    **dict.fromkeys(("ms", "msec", "msecs", "millisecond", "milliseconds"), 1e-3),
    **dict.fromkeys(("us", "usec", "µs", "μs", "microsecond", "microseconds"), 1e-6),
    **dict.fromkeys(("min", "mins", "minute", "minutes"), 60.0),
}
# what a time column may be counted in besides; refused by name
_OTHER_TIMES = ("h", "hr", "hrs", "hour", "hours", "day", "days", "index", "samples")
_LENGTHS = (
    "m",
    "dm",
    "cm",
    "mm",
    "km",
    "um",
    "µm",
    "μm",
    "nm",
    "ft",
    "feet",
    "inch",
    "in",
)
# what follows a length, as `_plain` writes it
PER_SECOND_SQUARED = ("/s/s", "/s2", "s-2", ".s-2", "*s-2", "ps2", "s2", "ss")
PER_SECOND = ("/s", "s-1", ".s-1", "*s-1", "ps")
# a word of a header: its quantity and its unit, which need not be one that is read
QUANTITIES: dict[str, tuple[str, str]] = {
    **{
        x + y: ("acceleration", f"{x}/s2") for x in _LENGTHS for y in PER_SECOND_SQUARED
    },
    **{x + y: ("velocity", f"{x}/s") for x in _LENGTHS for y in PER_SECOND},
    **{x: ("displacement", x) for x in _LENGTHS if x != "in"},
    **dict.fromkeys(("kine", "kines"), ("velocity", "cm/s")),
    **dict.fromkeys(("g", "gs"), ("acceleration", "g")),
    **dict.fromkeys(("gal", "gals"), ("acceleration", "cm/s2")),
    **{x: ("acceleration", x) for x in ("mg", "ug", "µg", "μg", "%g", "milli-g")},
    **{x: ("acceleration", x) for x in ("mgal", "milligal", "ugal", "µgal", "kgal")},
    **{x: ("unknown", x) for x in ("count", "counts", "volt", "volts")},
}
_KINDS = {
    "acceleration": re.compile(r"acc(?:el(?:eration)?s?|elerograms?)?[\dxyz]*$"),
    "velocity": re.compile(r"vel(?:ocit(?:y|ies))?[\dxyz]*$"),
    "displacement": re.compile(r"displ?(?:acements?)?[\dxyz]*$"),
}
_TIME_WORDS = ("t", "time", "times", "dt", "step", "interval", "intervals")
_OPENING, _CLOSING = ("(", "[", "{"), (")", "]", "}")
_INTRODUCING = {*_OPENING, "in", "of", "terms", "fraction", "fractions", "multiples"}
# words between "units" and the unit
_LINKS = {
    *_OPENING, *_CLOSING, *_TIME_WORDS, ",", ";", ":", "=", "of", "in", "is", "are",
    "the", "for", "and", "samples", "data", "values",
}  # fmt: skip
_SYSTEMS = {"si": "m/s2", "mks": "m/s2", "cgs": "cm/s2"}
_PEAKS = ("pga", "peak", "max", "min", "amax", "rms", "scale", "factor", "=", "*", "x")
# a part or a multiple of a unit: hundredths of g, 10^-3 g
_SCALES = re.compile(
    r"(?:%|per-?cent|milli|micro|centi|tenths?|hundredths?|thousandths?"
    r"|x?10-?\d+|1/10+|[x×*]\d\S*)$"
)
_TIMES_SIGNS = ("x", "×", "*", "times")
_FACTOR = re.compile(r"(?:x|×|\*|times)(?:\d\S*)?$")
# a length, g or gal per something, or g in percent: a unit, though perhaps none we know
_UNIT_LIKE = re.compile(rf"(?:%g|(?:{'|'.join(_LENGTHS)}|gal|g)(?:/s|/\d|\*\d))")
_PLAIN = [
    (re.compile(pattern), plain)
    for pattern, plain in (
        (r"['’`]s\b", "s"),
        (r"[²₂]", "2"),
        (r"¹", "1"),
        (r"[−⁻]", "-"),
        (r"·", "."),
        (r"_", " "),
        (r"\b(centi|milli|)met(?:er|re)s?\b", r"\1m"),
        (r"\bcentim\b", "cm"),
        (r"\bmillim\b", "mm"),
        (r"(?<![a-z])sec(?:ond)?s?(?![a-z])", "s"),
        (r"(?<![a-z])(?:inches|in(?=\s*/))(?![a-z])", "inch"),
        (r"(?<=[a-z])\s+per\s+(?=s)", "/"),
        (r"(?<![a-z])s\s*(?:squared|square|sq)(?![a-z])", "s2"),
        (r"\*\*", "^"),
        (r"\s*([/^])\s*", r"\1"),
        (r"\^?\((-?\d)\)", r"\1"),  # s^(-2)
        (r"\^", ""),
        (r"/\((s2|s[*.]s|s/s)\)", "/s2"),
        (r"(?<![a-z])(m|cm|mm|ft|inch)\s+s(?=-[12](?!\d))", r"\1s"),
        (r"(?<![a-z])(m|cm|mm)\s+s2(?!\w)", r"\1/s2"),  # acc_m_s2
        (r"(?<![\w/])(t|time|a[xyz\d]?|acc[a-z]*)/(?=[a-z(])", r"\1 in "),  # a/g
        (r"(?<=[a-z\d)\]])([*×])(?=\d)", r" \1 "),
        # 0.3g, but not 1e-3, of which nothing is to be cut off
        (r"(?<![\w.])((?>(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?))(?=[a-z%])", r"\1 "),
    )
]
_WORDS = re.compile(r"[()\[\]{}:=,;]|[^\s()\[\]{}:=,;]+")


class Said(NamedTuple):
    """What a line of a header says.

    Attributes:
        kinds: Quantities that it names: acceleration, velocity, displacement.
        units: Units of samples that it says, each with its quantity.
        mentions: Units behind a number, each with its quantity.
        times: Units of time that it says, of those of TIMES or others.
    """

    kinds: frozenset[str]
    units: tuple[tuple[str, str], ...]
    mentions: tuple[tuple[str, str], ...]
    times: tuple[str, ...]


def said(line: str) -> Said:
    """Quantities, units and units of time in a line of a header."""
    words = _words(line)
    found = [*_after_units(words), *_in_context(words)]
    kinds = {
        kind
        for i, word in enumerate(words)
        for kind, pattern in _KINDS.items()
        # the speed of waves in the ground is a fact of the site
        if pattern.match(word) and "wave" not in words[max(i - 1, 0) : i]
    }

    def picked(how: str) -> tuple[tuple[str, str], ...]:
        pairs = ((kind, unit) for where, kind, unit in found if where == how)
        return tuple(dict.fromkeys(pairs))

    times = tuple(unit for _, unit in picked("time"))
    return Said(frozenset(kinds), picked("says"), picked("mentions"), times)


def _words(line: str) -> list[str]:
    text = line.lower()
    for pattern, plain in _PLAIN:
        text = pattern.sub(plain, text)
    found = (word.strip("'\"#").rstrip(".") for word in _WORDS.findall(text))
    return [word for word in found if word]


def _is_number(word: str) -> bool:
    return NUMBER.match(word) is not None


def _is_kind(word: str) -> bool:
    return any(pattern.match(word) for pattern in _KINDS.values())


def _after_units(words: list[str]) -> Iterator[tuple[str, str, str]]:
    """What follows the words "units of", and their like."""
    for i, word in enumerate(words):
        if word not in ("unit", "units"):
            continue
        before = words[i - 1] if i else ""
        if before in _SYSTEMS:
            yield "says", "acceleration", _SYSTEMS[before]
        elif before in QUANTITIES:
            yield "says", *QUANTITIES[before]
        else:
            yield from _listed(words, i + 1, word == "units")


def _listed(words: list[str], i: int, several: bool) -> Iterator[tuple[str, str, str]]:
    """Units behind "units of": of time, then of samples; the first may be unknown."""
    first, found = i, False
    while i < len(words):
        word = words[i]
        if word in TIMES:
            yield "time", "", word
            found = True
        elif word in _SYSTEMS:
            yield "says", "acceleration", _SYSTEMS[word]
            found = True
        elif word in QUANTITIES and not _scaled(words, i):
            yield "says", *QUANTITIES[word]
            found = True
        elif not (word in _LINKS or _is_kind(word) or word in ("1", "1.0", "1.00")):
            # "Unit 2" of a power plant names no unit of samples
            if not found and (several or words[first] in _LINKS):
                yield "says", "unknown", " ".join(words[i : i + 3])
            return
        i += 1


def _scaled(words: list[str], i: int) -> bool:
    """Whether a unit is followed by a factor: g x 100, (g)*100, g x 10^-3."""
    i += 1 + (words[i + 1 : i + 2] in [[x] for x in _CLOSING])
    sign, factor = [*words[i : i + 2], "", ""][:2]
    if not _FACTOR.match(sign):
        return False
    return sign[-1].isdigit() or _is_number(factor) or bool(_SCALES.match(factor))


def _multiplied(words: list[str], j: int) -> bool:
    """Whether a factor ends with a word: 10 x, (x 0.01, acc * 1000."""
    sign = words[j] in _TIMES_SIGNS
    number = words[j - 1 if sign else j] if j or not sign else ""
    if not (_is_number(number) or _SCALES.match(number)):
        return False
    return sign or (j > 0 and words[j - 1] in _TIMES_SIGNS)


def _in_context(words: list[str]) -> Iterator[tuple[str, str, str]]:
    """Units that stand in brackets, behind "in", a quantity, "time" or a number."""
    for i, word in enumerate(words):
        j = i - 1
        while j >= 0 and words[j] in _INTRODUCING:
            j -= 1
        opened = any(link != "of" for link in words[j + 1 : i])
        comma = j > 0 and words[j] == "," and j == i - 1
        before = words[j - comma] if j >= 0 else ""
        if before in _TIME_WORDS and (word in TIMES or word in _OTHER_TIMES):
            # "time, min, max" has no minutes
            if word in ("s", "ms", "us") or opened or not comma:
                yield "time", "", word
        elif word in QUANTITIES:
            yield from _unit(words, i, j, opened, _is_kind(before))
        else:
            yield from _odd(words, i, j, opened)


def _odd(
    words: list[str], i: int, j: int, opened: bool
) -> Iterator[tuple[str, str, str]]:
    """A word that is no unit that is read, and yet tells of one."""
    word, before = words[i], words[j] if j >= 0 else ""
    if word in _SYSTEMS:
        how = "says" if _is_kind(before) else "mentions"
        yield how, "acceleration", _SYSTEMS[word]
    elif _is_kind(word) and j >= 0 and _multiplied(words, j):
        yield "says", "unknown", " ".join(words[max(j - 1, 0) : i + 1])
    elif _UNIT_LIKE.match(word):
        how = "mentions" if _is_number(before) and not opened else "says"
        yield how, "unknown", word
    elif words[max(i - 1, 0) : i + 2] in (["(", "in", ")"], ["[", "in", "]"]):
        yield "says", "displacement", "inch"
    elif _bracketed(words, i):
        yield "mentions", "unknown", word


def _unit(
    words: list[str], i: int, j: int, opened: bool, of_kind: bool
) -> Iterator[tuple[str, str, str]]:
    """A word that is a unit, if it is one here: says, mentions, or neither."""
    word, before = words[i], words[j] if j >= 0 else ""
    kind, unit = QUANTITIES[word]
    compound = "/" in word or "%" in word or word[-1].isdigit()
    if j >= 0 and _multiplied(words, j):
        yield "says", "unknown", " ".join(words[max(j - 1, 0) : i + 1])
    elif _SCALES.match(before):
        yield "says", "unknown", f"{before} {word}"
    elif _scaled(words, i):
        yield "says", "unknown", " ".join(words[i : i + 3])
    elif _is_number(before):
        outer = words[j - 1] if j else ""
        if kind == "acceleration" and float(before) != 1.0 and _of_samples(words, j):
            # acceleration (0.01 g), in 0.01 g; "acceleration, 0.01 g" may be a peak
            how = "says" if outer in (*_OPENING, "in") else "mentions"
            yield how, "unknown", f"{before} {word}"
        else:
            # "column 2 (g)" says, "PGA = 0.3 (g)" mentions
            a_value = "." in before or outer in _PEAKS or not opened
            yield "mentions" if a_value else "says", kind, unit
    elif compound or of_kind or (opened and _closed(words, i)):
        yield "says", kind, unit


def _of_samples(words: list[str], j: int) -> bool:
    """Whether a number stands behind a quantity that is not one of its peaks."""
    k = j - 1
    while k >= 0 and words[k] in (*_INTRODUCING, ",", "units", "unit"):
        k -= 1
    accelerations = k >= 0 and _KINDS["acceleration"].match(words[k])
    return bool(accelerations) and not set(_PEAKS) & set(words[:k])


def _bracketed(words: list[str], i: int) -> bool:
    """Whether a word that is nothing known stands in brackets behind a quantity."""
    behind = i > 1 and words[i - 1] in _OPENING and _is_kind(words[i - 2])
    return behind and not (
        _is_number(words[i]) or words[i] in _INTRODUCING or words[i] in TIMES
    )


def _closed(words: list[str], i: int) -> bool:
    """Whether nothing but the end of what was opened follows a short unit: (M 6.9)."""
    after = words[i + 1] if i + 1 < len(words) else ")"
    return not _is_number(after)
