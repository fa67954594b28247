"""Calls that were seen before: their checks and plans are looked up, not made again.

What is checked and planned of a run depends on its scene, the form of its start, the
times and the options; only the numbers of the start are others each time.
"""

import functools
from collections.abc import Callable, Hashable
from typing import Any, NamedTuple, cast

import jax
import numpy as np

from ..codegen.compile_effort import stays_as_it_is
from ..dynamics.scene import Scene
from ..hybrid.modes import Modes
from ..integration.backends import run_by
from ..integration.prepared import Prepared
from ..validation.remembered import remembered
from .trajectory import Trajectory

# Bytes of the times of a call that is kept, and how many are of a scene: 1 MB at most.
_MANY = 2**14
_MOST = 64


class ReadyCall(NamedTuple):
    """A checked call, but for the numbers of its scene and its start.

    It does not hold the scene, as long as which it is kept.

    Attributes:
        run: From a start to what came out.
        refusal: Why the loop in C cannot make it; None: it may.
        kind: Of the motion; see ``backends.run_by``.
        events: What is looked for.
        shown: ``shown(scene, outcome, method, why)`` -> the result.
    """

    run: Prepared
    refusal: str | None
    kind: Hashable
    events: tuple[Any, ...]
    shown: Callable[[Scene, Any, str, str], Trajectory]

    def __call__(self, method: str, scene: Scene, start: Any) -> Trajectory:
        """The result of a scene and a start, by the method that was asked for."""
        model = (scene, start, self.events) if self.events else (scene, start)
        run = functools.partial(self.run, start)
        return self.shown(scene, *run_by(method, self.refusal, self.kind, model, run))


@remembered(stays_as_it_is)
def _mark_of(modes: Modes) -> object | None:
    """One of its own for each; None of one whose numbers may change."""
    return object() if stays_as_it_is(modes) else None


@remembered(stays_as_it_is)
def calls_of(scene: Scene) -> dict[Hashable, ReadyCall]:
    """Those of a scene; none are kept of one whose numbers may change."""
    del scene
    return {}


def key_of_call(
    start: Any,
    times: Any,
    modes: Modes | None,
    options: tuple[Any, ...],
    others: tuple[Any, ...],
) -> Hashable | None:
    """What tells a call of a scene from others; None: it is not to be told.

    Args:
        start: Of which the form counts.
        times: Of which the numbers count.
        modes: Told by which they are, or None.
        options: Hashable, or nothing is told.
        others: None or empty, or nothing is told.
    """
    if not all(x is None or (isinstance(x, tuple) and not x) for x in others):
        return None
    mark = None if modes is None else _mark_of(modes)
    if modes is not None and mark is None:
        return None
    leaves, tree = cast("tuple[list[Any], Any]", jax.tree.flatten(start))
    try:
        form = tuple([(x.shape, x.dtype) for x in leaves])
        clock = np.asarray(times)
        kinds = tuple(map(type, options))  # 1 is not True
        asked = clock.shape, clock.dtype, clock.tobytes()
        key = tree, form, *asked, mark, options, kinds
        hash(key)
    except (AttributeError, TypeError, ValueError):
        return None
    plain = clock.dtype.kind in "fiu" and not np.ma.is_masked(times)
    return key if plain and clock.nbytes <= _MANY else None


def keep_call(scene: Scene, key: Hashable, ready: ReadyCall) -> None:
    """Keep a call of a scene, and not too many."""
    calls = calls_of(scene)
    if len(calls) >= _MOST:
        calls.clear()
    calls[key] = ready
