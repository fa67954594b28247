"""Distributions as tables of a file: a kind, and the constructor's own arguments."""

import inspect
from typing import Any, cast

from ..validation.checks import FieldError
from .directions import VonMisesFisher
from .distributions import (
    AbstractDistribution,
    LogNormal,
    Normal,
    Uniform,
    UniformOrientation,
)
from .empirical import Empirical
from .inertia_draws import InertiaPerturbation
from .joint_distributions import MultivariateNormal
from .truncation import Truncated

KINDS: dict[str, type[AbstractDistribution]] = {
    "normal": Normal,
    "uniform": Uniform,
    "log-normal": LogNormal,
    "von-mises-fisher": VonMisesFisher,
    "uniform-orientation": UniformOrientation,
    "multivariate-normal": MultivariateNormal,
    "empirical": Empirical,
    "inertia": InertiaPerturbation,
}
_LIMITS = ("low", "high")
_TRUNCATED = ("normal", "log-normal")


def distribution_of(table: Any) -> AbstractDistribution:
    """The distribution that a table describes.

    Args:
        table: ``distribution`` names its kind, the other keys are arguments of its
            constructor; ``low`` and ``high`` truncate a normal and a log-normal one.

    Raises:
        FieldError: an unknown kind, keys that it does not have, values that it refuses.
    """
    if not isinstance(table, dict):
        remedy = 'write distribution = "normal", mean and std'
        raise FieldError("distribution", table, "must be a table", remedy)
    given = dict(cast("dict[str, Any]", table))
    kind = given.pop("distribution", None)
    if not isinstance(kind, str) or kind not in KINDS:
        remedy = f"use one of {', '.join(KINDS)}"
        raise FieldError("distribution", kind, "is no known kind", remedy)
    limits = {k: given.pop(k) for k in _LIMITS if k in given and kind in _TRUNCATED}
    wanted = inspect.signature(KINDS[kind]).parameters
    missing = [name for name, p in wanted.items() if p.default is p.empty]
    missing = [name for name in missing if name not in given]
    unknown = [name for name in given if name not in wanted]
    if missing or unknown:
        problem = f"lacks {', '.join(missing)}" if missing else "has unknown keys"
        remedy = f"{kind} takes {', '.join(wanted) or 'nothing'}"
        raise FieldError("distribution", table, problem, remedy)
    found = KINDS[kind](**given)
    if not limits:
        return found
    ends = (limits.get("low", -float("inf")), limits.get("high", float("inf")))
    return Truncated(cast(Any, found), *ends)
