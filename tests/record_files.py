"""Small files of records in the forms that the readers take."""

import numpy as np

AT2 = """SOME DATA BASE

SOME QUAKE, STATION, 360

ACCELERATION TIME HISTORY IN UNITS OF G
{header}
   .1000000E-02  -.2000000E-02   .3000000E-02
  -.4000000E-02   .5000000E-02
"""
COLUMNS = "t a\n0.00 1\n0.01 2\n0.02 3\n{row}\n0.04 5\n0.05 6\n"
SINGLE = "some quake\n5 0.0100\n1.0e-3\n-2.0e-3\n3.0e-3\n-4.0e-3\n5.0e-3\n"
HEADER = 26  # lines of text and numbers before the samples of a V2A component
NAMES = ("N28W", "S62W", "Up")


def v2a_lines(counts=(12, 5, 5), step="0.0200", names=NAMES, text=None, first=10000.1):
    """A file whose fields touch, as its lines.

    Args:
        counts: Samples of acceleration, velocity and displacement.
        step: As it is printed.
        names: Of the components.
        text: Lines of the text that are not just "text", by their number from 0.
        first: The first sample of a component, which then grow by 1.
    """
    lines = []
    for k, name in enumerate(names):
        top = ["Corrected accelerogram TEST", *["text"] * 15]
        top[12] = f"Component {name}   Some axis"
        for i, line in (text or {}).items():
            top[i] = line
        numbers = ["       1" * 10] * 10
        numbers[3] = "".join(f"{x:>8}" for x in (65536, 250, 250, *counts, 0, 0, 2, 3))
        numbers[6] = (
            "  327.68    5.00    5.00    1.00  0.0050" + f"{step:>8}" + "      0."
        )
        lines += top + numbers
        for block, count in enumerate(counts):
            values = (-1) ** k * (-first - np.arange(int(float(count)))) * (block == 0)
            rows = [values[i : i + 10] for i in range(0, len(values), 10)]
            lines += ["".join(f"{x:8.1f}" for x in row) for row in rows]
    return lines


def v2a(cut=None, **how):
    """The same as text, perhaps only its first lines."""
    return "\n".join(v2a_lines(**how)[:cut]) + "\n"
