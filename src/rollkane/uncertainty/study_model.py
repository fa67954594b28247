"""A study as a model: outputs of any uniform numbers, and their slopes."""

from concurrent.futures import ThreadPoolExecutor
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..hybrid.modes import modes_of
from ..simulation.ensemble_run import processors
from ..simulation.run import simulate
from ..validation.checks import FieldError
from ..validation.codes import Code, reason_of
from .draws import Draws
from .evaluation import Evaluated, Model, Slopes, entry
from .member_statistics import values_of
from .moded_views import value_of
from .study import Study
from .unit_runs import Columns, UnitRuns

# Motions whose gradients are taken in one program
_AT_ONCE = 64


class StudyModel:
    """Motions of a study, for what asks for many of them: indices, rare events.

    Outputs are those that :class:`MonteCarlo` has statistics of: observables, events
    (whether they happened, ``NAME time``, ``NAME count``).

    Attributes:
        study: What moves.
        draws: Its distributions.
    """

    def __init__(self, study: Study):
        """Compile the study's runs.

        Raises:
            FieldError: as :class:`UnitRuns`.
        """
        self.study, self.draws = study, study.draws
        self._runs = UnitRuns(study)
        self._slopes: dict[str, Any] = {}

    def evaluate(self, u: Float[np.ndarray, "n d"]) -> Evaluated:
        """Outputs of members, on all processors.

        Args:
            u: Their uniform numbers [1].

        Returns:
            Outputs; the code is 0 for every motion that ended as it should.
        """
        unit = self._runs.unit
        # each processor has some, and no unit is larger than what a program takes
        size = max(1, min(unit, -(-len(u) // processors())))
        parts = [u[first : first + size] for first in range(0, max(len(u), 1), size)]
        with ThreadPoolExecutor(processors()) as pool:
            found = list(pool.map(self._runs.members, parts))
        joined: Columns = {k: np.concatenate([c[k] for c in found]) for k in found[0]}
        return Evaluated(values_of(self._runs.columns, joined), self._code(joined))

    def _code(self, columns: Columns) -> np.ndarray:
        good = np.isin(columns["code"], self.study.ends)
        return np.where(good, Code.COMPLETED, columns["code"])

    def reason_of(self, code: int) -> str:
        """What a code says."""
        return reason_of(code)

    def value_and_gradient(self, u: Float[np.ndarray, "n d"], of: str) -> Slopes:
        """An observable at the last time, and its gradient by u.

        Args:
            u: Uniform numbers of members [1].
            of: Name of an observable, with an index where it is an array.

        Raises:
            FieldError: no such observable, or one that is true or false; a study with
                an event that stops motions, whose ends have no such gradients.
        """
        self._check_slope(of)
        if of not in self._slopes:
            self._slopes[of] = jax.jit(jax.vmap(self._slope_of(of)))
        parts: list[Any] = []
        for first in range(0, len(u), _AT_ONCE):
            rows = u[first : first + _AT_ONCE]
            filled = np.concatenate([rows, np.repeat(rows[-1:], _AT_ONCE, axis=0)])
            found = self._slopes[of](jnp.asarray(filled[:_AT_ONCE]))
            parts.append([np.asarray(x)[: len(rows)] for x in found])
        values, gradients, code = (np.concatenate(x) for x in zip(*parts, strict=True))
        return Slopes(values, gradients, np.where(code == 0, Code.COMPLETED, code))

    def _slope_of(self, of: str) -> Any:
        study, made = self.study, self._runs.made
        times = study.times[[0, -1]]
        options = {k: v for k, v in study.options.items() if v is not None}

        def ended(u: Float[Array, " d"]) -> tuple[Array, Array]:
            scene, start = made.one(u)
            run = simulate(scene, start, times, modes=modes_of(scene), **options)
            last = jax.tree.map(_last, run.state)
            seen = {
                name: value_of(f, scene, run.time[-1], last)[None]
                for name, f in study.observe.items()
            }
            return entry(seen, of, "value_and_gradient.of")[0], run.code

        def slope(u: Float[Array, " d"]) -> tuple[Array, Array, Array]:
            (value, code), gradient = jax.value_and_grad(ended, has_aux=True)(u)
            return value, gradient, code

        return slope

    def _check_slope(self, of: str) -> None:
        field = "value_and_gradient.of"
        name = of.partition("[")[0]
        column = self._runs.columns.get(name)
        if column is None or column.kind != "observed":
            known = [n for n, c in self._runs.columns.items() if c.kind == "observed"]
            remedy = f"use one of {', '.join(known)}"
            raise FieldError(field, of, "is no observable with a gradient", remedy)
        if self.study.stop or any(event.stop for event in self.study.events):
            problem = "has no gradient where an event stops motions"
            raise FieldError(field, of, problem, "leave stop out")


def _last(x: Array) -> Array:
    return x[-1]


def model_of(given: Model | Study) -> Model:
    """A study as a model; a model as it is.

    Raises:
        FieldError: neither of them.
    """
    if isinstance(given, Study):
        return StudyModel(given)
    draws = getattr(cast(Any, given), "draws", None)
    if not isinstance(draws, Draws) or not callable(getattr(given, "evaluate", None)):
        remedy = "give a rollkane.Study, or a rollkane.FunctionModel"
        raise FieldError("model", given, "is no model", remedy)
    return given
