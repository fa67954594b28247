"""A fit as one HTML page that opens from disk, without a network."""

import base64
import html
from collections.abc import Iterable
from os import PathLike
from statistics import NormalDist

import numpy as np
from jaxtyping import Float

from ..files.atomic_file import write_whole
from ..files.file_endings import PAGES, wrong_ending
from ..identification.estimates import Estimates
from ..identification.report import Row, rows, text_report
from ..identification.unseen import REMEDY
from ..validation.checks import FieldError
from .plot_fit import figure_fit
from .plot_style import BLUE, INK, RED, png

_LEVEL = 0.95  # probability of the intervals
_STYLE = f"""
body {{ font: 15px/1.5 system-ui, sans-serif; color: {INK}; max-width: 62rem;
       margin: 2rem auto; padding: 0 1rem; background: white; }}
h1 {{ font-size: 1.5rem; }}
h2 {{ font-size: 1.1rem; margin-top: 2rem; }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums; }}
th, td {{ padding: 0.2rem 0.7rem; text-align: right; }}
th {{ font-weight: 600; }}
th:first-child, td.note {{ text-align: left; }}
.estimates tr + tr {{ border-top: 1px solid #e6e9ee; }}
.correlation {{ font-size: 0.8rem; }}
.correlation td {{ min-width: 2.6rem; padding: 0.2rem 0.3rem; text-align: center; }}
.scroll {{ overflow-x: auto; }}
pre {{ background: #f5f7f9; padding: 0.8rem; overflow-x: auto; font-size: 0.85rem; }}
img {{ max-width: 100%; }}
"""


def write_fit_page(fit: Estimates, path: str | PathLike[str], title: str = "") -> None:
    """Write a fit as a self-contained page: estimates, correlations, pictures, report.

    Args:
        fit: What was found.
        path: Where to, .html; the folder must exist. The file appears whole or not at
            all.
        title: Heading of the page; plain text.

    Raises:
        FieldError: another ending.
        ImportError: matplotlib is not installed.
        OSError: the file cannot be written.
    """
    wrong = wrong_ending(path, PAGES)
    if wrong is not None:
        raise FieldError("path", str(path), *wrong)
    write_whole(path, fit_page(fit, title).encode())


def fit_page(fit: Estimates, title: str = "") -> str:
    """The text of the page that :func:`write_fit_page` writes.

    Args:
        fit: What was found.
        title: Heading of the page; plain text.

    Raises:
        ImportError: matplotlib is not installed.
    """
    head = html.escape(title or "Fit")
    picture = base64.b64encode(png(figure_fit(fit))).decode()
    known = rows(fit)
    parts = [
        f"<h1>{head}</h1>",
        *_section("Estimates", _estimates(known)),
        *_unseen(fit),
        *_section(
            "Samples and prediction",
            [f'<img alt="samples" src="data:image/png;base64,{picture}">'],
        ),
        *_section("Correlations", _correlations(fit.correlation, known)),
        *_section("Report", [f"<pre>{html.escape(text_report(fit))}</pre>"]),
    ]
    begin = '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">'
    middle = f"<title>{head}</title>\n<style>{_STYLE}</style>\n</head>\n<body>"
    return "\n".join([begin, middle, *parts, "</body>\n</html>\n"])


def _section(title: str, lines: Iterable[str]) -> list[str]:
    return [f"<h2>{title}</h2>", '<div class="scroll">', *lines, "</div>"]


def _estimates(known: list[Row]) -> list[str]:
    """A row for each named number, with its interval."""
    quantile = NormalDist().inv_cdf(0.5 + 0.5 * _LEVEL)
    lines = ['<table class="estimates">', "<tr><th>parameter</th><th>estimate</th>"]
    lines += ["<th>standard error</th>"]
    lines += [f"<th>{100 * _LEVEL:.0f} % from</th><th>to</th><th></th></tr>"]
    for name, value, error, note in known:
        cells = [f"{value:.6g}", "", "", ""]
        if not note:
            ends = value - quantile * error, value + quantile * error
            cells[1:] = [f"{error:.3g}", *(f"{end:.6g}" for end in ends)]
        shown = "".join(f"<td>{cell}</td>" for cell in cells)
        named = f"<th>{html.escape(name)}</th>"
        lines.append(f'<tr>{named}{shown}<td class="note">{note}</td></tr>')
    return [*lines, "</table>"]


def _unseen(fit: Estimates) -> list[str]:
    if not fit.unseen:
        return []
    listed = [f"<li>{html.escape(sentence)}</li>" for sentence in fit.unseen]
    ends = ["<ul>", *listed, "</ul>", f"<p>{html.escape(REMEDY.strip())}</p>"]
    return _section("Not seen in the records", ends)


def _correlations(
    correlation: Float[np.ndarray, "n n"], known: list[Row]
) -> Iterable[str]:
    """A table whose cells are the redder or the bluer the stronger they are."""
    yield '<table class="correlation">'
    numbered = "".join(f"<th>{k + 1}</th>" for k in range(len(known)))
    yield f"<tr><th></th><th></th>{numbered}</tr>"
    for i, row in enumerate(known):
        cells = "".join(
            _cell(float(value), bool(known[i].note or known[k].note))
            for k, value in enumerate(correlation[i])
        )
        yield f"<tr><th>{html.escape(row.name)}</th><th>{i + 1}</th>{cells}</tr>"
    yield "</table>"
    if any(row.note for row in known):
        yield "<p>Empty: of numbers that are not seen, or on a bound.</p>"


def _cell(value: float, unknown: bool) -> str:
    if unknown:
        return "<td></td>"
    strength = min(abs(value), 1.0)
    colour = RED if value > 0.0 else BLUE
    # of a share of the colour over white, text stays readable below one half
    shade = f"{colour}{round(255 * 0.55 * strength):02x}"
    return f'<td style="background:{shade}">{value:.2f}</td>'
