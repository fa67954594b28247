"""Runs of a study's members in units, so that a member is the same in every block.

What XLA compiles rounds by the shape that it is compiled for, and by a member's place
in it. So programs always take a whole unit of members that begins at a multiple of its
size, and a member stands at the same place of the same program whichever block, process
or machine of the same kind asks for it.
"""

import threading
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..codegen import platform
from ..dynamics.scene import Scene
from ..simulation.ensemble_result import Ensemble
from ..simulation.ensemble_run import EnsembleRun
from ..validation.checks import FieldError
from .draws import flat
from .made_members import MadeMembers
from .moded_views import rolling_of, value_of
from .study import Observable, Study

# Members of a unit: in lanes as many as hide what a call costs; those that one program
# takes at once, few, since all of them are computed where one is wanted; on a GPU
# many: it takes as long for one as for so many
_IN_LANES, _AT_ONCE, _ON_GPU = 1024, 64, 2**15
# units that are kept where blocks are smaller: more than threads work at
_KEPT = 16

Columns = dict[str, np.ndarray]


class Column(NamedTuple):
    """What is kept of every member under one name.

    Attributes:
        shape: Of one member's value.
        dtype: Of the numbers.
        kind: ``"draw"``, ``"observed"``, ``"truth"`` (1: true, 0: false), ``"series"``,
            ``"count"``, ``"event time"`` or ``"run"``; NaN where a motion failed.
    """

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    kind: str


class _Unit(NamedTuple):
    """A unit that is kept, once it is computed.

    Attributes:
        lock: Held while it is.
        columns: None before, one entry behind.
    """

    lock: threading.Lock
    columns: list[Columns]


class UnitRuns:
    """Compiles a study's runs once, and makes units of members.

    Attributes:
        unit: Members of a unit.
        columns: What is kept of every member, by name.
        method: ``"native"`` or ``"diffrax"``; empty before the first run.
        why: Why it is not the loop in C; empty where it is.
        fields: Names of the numbers that ``fault`` counts.
    """

    def __init__(self, study: Study):
        """Make the middle member, and compile the loop.

        Raises:
            FieldError: as :class:`MadeMembers` and :func:`rollkane.ensemble`; an
                observable that gives no real numbers.
        """
        self.study = study
        self.made = MadeMembers(study.make, study.draws, study.times[0], study.modes)
        self.unit = _IN_LANES
        self._run = self._runs_of(_IN_LANES)
        if self._run.lanes is None:
            on_gpu = platform() == "cuda" and self._run.modes is None
            self.unit = _ON_GPU if on_gpu else _AT_ONCE
            self._run = self._runs_of(self.unit)
        self.method = self.why = ""
        self.fields = self._run.fields
        self._shapes = self._observed_shapes()
        observables = *study.observe.values(), *study.series.values()
        self.made.check([*observables, *study.events, *study.stop])
        self.columns = self._columns()
        self._units: OrderedDict[int, _Unit] = OrderedDict()
        self._lock = threading.Lock()

    def _runs_of(self, size: int) -> EnsembleRun:
        study = self.study
        return EnsembleRun(
            *(self.made.members(size), None, study.times),
            **study.options,
            events=study.events,
            stop=study.stop,
            block=size,
        )

    def members(self, u: Float[np.ndarray, "n d"]) -> Columns:
        """What is kept of members, n of them: the first ones of a unit.

        Args:
            u: Their uniform numbers, n at most ``unit``.
        """
        count = len(u)
        scene, starts = self.made.block(self._filled(u))
        run = self._run.block_of(scene, starts, 0, count)
        self.method, self.why = run.method, run.why
        study = self.study
        columns = self._drawn(u)
        good = np.isin(run.code, study.ends)
        ended = self._seen(study.observe, scene, run.final_time, run.final_state)
        columns |= {name: _of_good(x, good) for name, x in ended.items()}
        if study.series:
            columns |= self._series(scene, run, good)
        columns |= _happened(run)
        columns |= {
            "code": np.asarray(run.code, np.int32),
            "fault": np.asarray(run.fault, np.int32),
            "final_time": np.asarray(run.final_time, float),
            "steps": np.asarray(run.steps, np.int32),
        }
        return columns

    def block(
        self,
        first: int,
        last: int,
        uniforms: Callable[[int, int], np.ndarray],
        size: int,
    ) -> Columns:
        """What is kept of a range of members.

        Args:
            first: Number of the first.
            last: One behind the last.
            uniforms: Uniform numbers of members, of a first one and a count.
            size: How many members there are.
        """
        parts: list[Columns] = []
        for begin in range(first - first % self.unit, last, self.unit):
            low, high = max(first - begin, 0), min(last - begin, self.unit)
            count = min(size - begin, self.unit)
            if low == 0 and high == count:
                parts.append(self.members(uniforms(begin, count)))
                continue
            whole = self._kept(begin, count, uniforms)
            parts.append({name: x[low:high] for name, x in whole.items()})
        return {name: np.concatenate([p[name] for p in parts]) for name in parts[0]}

    def _kept(
        self, begin: int, count: int, uniforms: Callable[[int, int], np.ndarray]
    ) -> Columns:
        """A unit of which blocks are parts: computed once, for the blocks to come."""
        with self._lock:
            unit = self._units.setdefault(begin, _Unit(threading.Lock(), []))
            while len(self._units) > _KEPT:
                self._units.popitem(last=False)
        with unit.lock:
            if not unit.columns:
                unit.columns.append(self.members(uniforms(begin, count)))
        return unit.columns[0]

    def _drawn(self, u: np.ndarray) -> Columns:
        """What was drawn, by dotted name."""
        drawn = flat(_drawn(self.study.draws, jnp.asarray(self._filled(u))))
        return {f"draw.{name}": np.asarray(x)[: len(u)] for name, x in drawn.items()}

    def _seen(
        self, functions: Mapping[str, Observable], scene: Any, time: Any, state: Any
    ) -> Columns:
        """Values of observables, in a whole unit's program."""
        if not functions:
            return {}
        count = len(time)
        time, state = jax.tree.map(self._filled, (time, state))
        axes = self._run.members.axes()[0]
        values = _observed(tuple(functions.items()), axes, scene, time, state)
        return {name: np.asarray(x)[:count] for name, x in values.items()}

    def _series(self, scene: Any, run: Ensemble, good: np.ndarray) -> Columns:
        """Values on the way, of motions that ended as they should, up to their ends."""
        count = len(run.code)
        time = np.broadcast_to(np.asarray(run.time), (count, len(run.time)))
        seen = self._seen(self.study.series, scene, time, run.state)
        passed = np.abs(time - time[:, :1])
        ended = np.abs(np.asarray(run.final_time)[:, None] - time[:, :1])
        reached = good[:, None] & (passed <= ended)
        return {name: _of_good(x, reached) for name, x in seen.items()}

    def _filled(self, x: Any) -> np.ndarray:
        x = np.asarray(x)
        missing = self.unit - len(x)
        return np.concatenate([x, np.repeat(x[-1:], missing, axis=0)])

    def _observed_shapes(self) -> dict[str, Any]:
        """Shapes and types of one member's observables."""
        time = jnp.zeros((), self.study.times.dtype)
        found: dict[str, Any] = {}
        both = {"observe": self.study.observe, "series": self.study.series}
        for field, functions in both.items():
            for name, function in functions.items():
                where = f"Study.{field}[{name!r}]"
                found[name] = self._shape_of(where, function, time)
        return found

    def _shape_of(self, where: str, function: Observable, time: Any) -> Any:
        remedy = "return one array of numbers or truth values, by jax.numpy"
        scene, start = rolling_of(self.made.scene, self.made.start)
        asarray: Callable[[Any, Any, Any], Any] = lambda scene, t, state: jnp.asarray(
            function(scene, t, state)
        )
        try:
            shape = jax.eval_shape(asarray, scene, time, start)
        except FieldError:
            raise
        except Exception as error:
            first = str(error).partition("\n")[0]
            problem = f"cannot be used ({first})"
            raise FieldError(where, function, problem, remedy) from error
        if shape.dtype.kind not in "biuf":
            raise FieldError(where, function, f"gives a {shape.dtype}", remedy)
        return shape

    def _columns(self) -> dict[str, Column]:
        real, whole = np.dtype(float), np.dtype(np.int32)
        study = self.study
        drawn = jax.eval_shape(study.draws.draw, jnp.zeros(study.draws.dimension))
        found = {
            f"draw.{k}": Column(x.shape, real, "draw") for k, x in flat(drawn).items()
        }
        for name in study.observe:
            shape = self._shapes[name]
            kind = "truth" if shape.dtype.kind == "b" else "observed"
            found[name] = Column(shape.shape, real, kind)
        for name in study.series:
            shape = (len(study.times), *self._shapes[name].shape)
            found[name] = Column(shape, real, "series")
        for event in self._run.events:
            found[f"{event.name}.count"] = Column((), whole, "count")
            found[f"{event.name}.time"] = Column((event.most,), real, "event time")
        found |= {name: Column((), whole, "run") for name in ("code", "fault", "steps")}
        return found | {"final_time": Column((), real, "run")}


def _of_good(x: np.ndarray, good: np.ndarray) -> np.ndarray:
    where = good.reshape(good.shape + (1,) * (x.ndim - good.ndim))
    return np.where(where, x, np.nan)


def _happened(run: Ensemble) -> Columns:
    """How often events happened, and when."""
    found: Columns = {}
    for name, crossings in run.events.items():
        found[f"{name}.count"] = np.asarray(crossings.count, np.int32)
        found[f"{name}.time"] = np.asarray(crossings.times, float)
    return found


@eqx.filter_jit
def _drawn(draws: Any, u: Any) -> Any:
    return jax.vmap(draws.draw)(u)


@eqx.filter_jit
def _observed(
    functions: tuple[tuple[str, Observable], ...],
    axes: Any,
    scene: Any,
    time: Any,
    state: Any,
) -> dict[str, Any]:
    def one(scene: Scene, t: Any, state: Any) -> dict[str, Any]:
        return {name: value_of(f, scene, t, state) for name, f in functions}

    if jnp.ndim(time) == 2:  # at every time
        of_times = jax.vmap(one, (None, 0, 0))
        return jax.vmap(of_times, (axes, 0, 0))(scene, time, state)
    return jax.vmap(one, (axes, 0, 0))(scene, time, state)
