"""What came out of an ensemble: motions of many members."""

from collections import Counter
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from ..kinematics.coordinates import State
from ..validation.codes import Code, Fields
from .event_record import Crossings, EventRecord


class Ensemble(eqx.Module):
    """Motions of N members at T times, as NumPy arrays.

    Attributes:
        time: [s], shape (T,).
        state: States at these times, every array with (N, T) in front, NaN where not
            reached; None where something else was observed.
        observed: What ``observe`` gave, every array with (N, T) in front; None without.
        code: Why each motion ended, one of :class:`Code`, shape (N,); 0 is success.
        final_time: Time that was reached [s], shape (N,).
        final_state: State at that time, every array with (N,) in front.
        steps: Accepted steps, shape (N,).
        rejected_steps: Rejected steps, shape (N,).
        fault: Which number of the scene, the start or the times cannot be used, as
            ``reasons`` names it, shape (N,); -1: none.
        first: Number of the first member: of a block, its place in the ensemble.
        method: ``"native"`` or ``"diffrax"``: which integrated.
        why: Why it was not the native loop; empty if it was, or if diffrax was asked.
        fields: Names of the numbers that ``fault`` counts.
        event_record: Events of the members, as ``events`` shows them; None without.
    """

    time: Float[Array, " T"]
    state: State | None
    observed: Any
    code: Int[Array, " N"]
    final_time: Float[Array, " N"]
    final_state: State
    steps: Int[Array, " N"]
    rejected_steps: Int[Array, " N"]
    fault: Int[Array, " N"]
    first: int
    method: str = eqx.field(static=True)
    why: str = eqx.field(static=True)
    fields: Fields = eqx.field(static=True)
    event_record: EventRecord | None = None

    @property
    def succeeded(self) -> Any:
        """Whether each motion reached its last time, shape (N,)."""
        return self.code == Code.COMPLETED

    @property
    def events(self) -> dict[str, Crossings]:
        """Where each event happened, by its name: ``times`` [s], ``states``, ``count``.

        Times of shape (N, most), as many as are kept, unused places NaN; counts (N,).
        """
        return {} if self.event_record is None else self.event_record.by_name()

    @property
    def reasons(self) -> dict[str, int]:
        """Why motions ended, and how many ended so."""
        codes, faults = np.asarray(self.code).tolist(), np.asarray(self.fault).tolist()
        found = self.event_record
        ends = [""] * len(codes)
        if found is not None:
            ends = list(map(found.name_of_end, np.asarray(found.by).tolist()))
        counts = Counter(zip(codes, faults, ends, strict=True))
        return {self.fields.reason(*why): n for why, n in sorted(counts.items())}
