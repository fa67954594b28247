"""A fit in words and a table."""

from typing import NamedTuple

import numpy as np

from . import uncertainty
from .estimates import Estimates
from .losses import loss_of
from .unseen import REMEDY

_STRONG = 0.95  # correlations that are told
_FAR = 5.0  # deviations of chi2, or of a correlation, in which it is no chance
_ROUNDING = 1e-2  # chi2 of a sample, below which misfits are no noise as was told


def text_report(fit: Estimates) -> str:
    """Estimates with errors, how good the fit is, and what is not seen."""
    lines = ["Fit", *_how(fit), "", *_estimates(fit), "", *_channels(fit)]
    pairs = _correlations(fit)
    lines += ["", "Correlations above 0.95:", *pairs] if pairs else []
    if fit.unseen:
        lines += ["", "Not seen in the records:", *(f"  {s}" for s in fit.unseen)]
        lines.append(REMEDY)
    return "\n".join(lines)


def _how(fit: Estimates) -> list[str]:
    freedom = fit.degrees_of_freedom
    found = [
        f"  chi2 / degrees of freedom  {fit.chi2:.6g} / {freedom} = "
        f"{fit.chi2 / max(freedom, 1):.4g}",
        f"  rollouts                   {fit.rollouts}, with derivatives; "
        f"{fit.failed} did not reach their end",
    ]
    if not fit.converged:
        found.append("  NOT converged: more evaluations, or a better guess, are needed")
    found += _landings(fit)
    if len(fit.stages) > 1:
        horizons = ", ".join(f"{s.horizon:.3g}" for s in fit.stages)
        found.append(f"  horizons                   {horizons} s")
    if len(fit.minima) > 1:
        listed = ", ".join(f"{chi2:.6g} ({n} of them)" for chi2, n in fit.minima)
        found.append(f"  distinct minima, by chi2   {listed}")
    return found


def _landings(fit: Estimates) -> list[str]:
    """How often runs land, and what that may have made of the fit."""
    listed: list[int] = np.atleast_1d(fit.landings).tolist()
    if not any(listed):
        return []
    found = [f"  landings                   {', '.join(map(str, listed))}"]
    freedom = max(fit.degrees_of_freedom, 1)
    if fit.chi2 > freedom + _FAR * np.sqrt(2.0 * freedom):
        found += [
            "    Velocities jump where a body lands, and chi2 has a minimum where one",
            "    passes a sample: this may not be the least. Fit positions, or begin",
            "    from several guesses (starts=)",
        ]
    return found


class Row(NamedTuple):
    """A named number of the covariance.

    Attributes:
        name: As of ``Fit.names``.
        value: Its estimate.
        error: Standard error; infinite where it is not seen, 0 on a bound.
        note: ``"not seen"``, ``"on bound"`` or ``""``.
    """

    name: str
    value: float
    error: float
    note: str


def rows(fit: Estimates) -> list[Row]:
    """Estimates and standard errors of all named numbers, in their order."""
    layout, z = fit.problem.layout, fit.search.minimum.z
    at = fit.search.minimum.at
    errors = iter(np.sqrt(np.diag(fit.covariance)))
    unseen = uncertainty.unseen_directions(at, layout)
    held = uncertainty.active(at, layout, z, loss_of(fit.loss))
    found: list[Row] = []
    for entry in layout.entries:
        at_minimum = entry.at(z)
        values, slope = at_minimum.shown, at_minimum.shown_slope
        hidden = uncertainty.hidden(slope, unseen, entry.where)
        labels = entry.transform.labels()
        for label, value, is_hidden in zip(labels, values, hidden, strict=True):
            error, note = float(next(errors)), ""
            if is_hidden:
                error, note = np.inf, "not seen"
            elif held[entry.where].all():
                note = "on bound"
            found.append(Row(entry.name + label, float(value), error, note))
    return found


def _estimates(fit: Estimates) -> list[str]:
    lines = [f"  {'parameter':<36}{'estimate':>14}{'std. error':>14}{'relative':>10}"]
    for name, value, error, note in rows(fit):
        told = note or f"{error:.3g}"
        known = value and not note
        share = f"{100 * error / abs(value):.2g} %" if known else ""
        lines.append(f"  {name:<36}{value:>14.6g}{told:>14}{share:>10}")
    return lines


def _channels(fit: Estimates) -> list[str]:
    several = isinstance(fit.residuals, list)
    residuals = fit.residuals if several else [fit.residuals]
    sigmas = fit.sigma if several else [fit.sigma]
    lines = [f"  {'channel':<20}{'samples':>9}{'chi2/N':>9}{'whiteness':>11}  sigma"]
    told: list[str] = []
    for number, (per, sigma) in enumerate(zip(residuals, sigmas, strict=True)):
        for name, misfit in per.items():
            shown = f"{name} {{{number}}}" if several else name
            count = int(np.isfinite(misfit).sum())
            chi2 = np.nansum(misfit**2) / max(count, 1)
            noise = ", ".join(f"{s:.3g}" for s in sigma[name])
            white = whiteness(misfit)
            lines.append(f"  {shown:<20}{count:>9}{chi2:>9.3f}{white:>11.2f}  {noise}")
            told += _alike(shown, misfit)
    lines.append(
        "  whiteness: correlation of neighbours over its deviation; |3| is a lot"
    )
    return lines + told


def _alike(name: str, misfit: np.ndarray) -> list[str]:
    """What misfits that are like their neighbours do to errors, in words.

    Of noise with the correlation r^k of samples k apart, and of parameters that samples
    show slowly, the mean of N samples is known as by ``N (1 - r) / (1 + r)`` of them.
    """
    rounding = np.nanmean(misfit**2) < _ROUNDING
    if whiteness(misfit) <= _FAR or rounding:
        return []
    r = min(_correlation(misfit)[0], 0.99)
    factor = np.sqrt((1.0 + r) / (1.0 - r))
    return [
        f"  Neighbours of {name} are alike, but errors take noise to be white: if it",
        f"    is noise, errors may be {factor:.2g} times as large; else something is",
        "    missing in the model",
    ]


def whiteness(misfit: np.ndarray) -> float:
    """Correlation of neighbouring misfits times the root of their number.

    Of white noise normal with deviation 1; large where the model leaves something out.
    """
    value, pairs = _correlation(misfit)
    return float(value * np.sqrt(pairs))


def _correlation(misfit: np.ndarray) -> tuple[float, int]:
    """Of neighbouring misfits, and of how many pairs; 0 of none, or of zeros."""
    before, after = misfit[:-1], misfit[1:]
    both = np.isfinite(before) & np.isfinite(after)
    pairs = int(both.sum())
    if pairs < 2 or (power := np.nanmean(misfit**2)) == 0.0:
        return 0.0, pairs
    return float(np.sum(np.where(both, before * after, 0.0)) / (power * pairs)), pairs


def _correlations(fit: Estimates) -> list[str]:
    found: list[str] = []
    for i in range(len(fit.names)):
        for k in range(i):
            value = fit.correlation[i, k]
            if abs(value) > _STRONG:
                found.append(f"  {fit.names[k]}, {fit.names[i]}: {value:+.3f}")
    return found[:20]
