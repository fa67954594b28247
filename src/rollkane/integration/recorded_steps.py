"""The steps that a run took, as its derivatives need them."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..codegen import Way
from .step_control import Landings


class Steps(NamedTuple):
    """Recorded steps; time runs forwards in them.

    Attributes:
        record: Where steps began, and the last one ended [s], shape (n,); any numbers
            behind.
        count: How many there are.
        sense: 1, or -1 where the run went backwards in time.
        outputs: Times of outputs [s], in order, shape (T,); of those at one time only
            the last is shown.
        landings: Where they had to end, and the next ones to begin.
        kept: States where every 16th step began, the first included, shape (m, n).
    """

    record: Float[Array, " n"]
    # a tuple has a method of this name, which is not wanted of these
    count: Array  # pyright: ignore[reportIncompatibleMethodOverride]
    sense: Array
    outputs: Float[Array, " T"]
    landings: Landings
    kept: Float[Array, "m n"]

    @staticmethod
    def of(
        record: Float[Array, " n"],
        count: Array,
        kept: Float[Array, "m n"],
        times: Float[Array, " T"],
        landings: Landings,
    ) -> "Steps":
        """Of what was recorded, times of outputs [s], and where steps had to end."""
        sense = jnp.where(times[-1] < times[0], -1.0, 1.0).astype(times.dtype)
        where = landings.turned(sense)
        return Steps(record, count, sense, sense * times, where, kept)

    def span(self, i: Array) -> tuple[Array, Array, Array]:
        """Where a step begins, where it ends and where the next one begins [s]."""
        begin, following = self.sense * self.record[i], self.sense * self.record[i + 1]
        return begin, self.landings.end_before(following)[0], following

    def shows(self, i: Array, output: Array) -> Bool[Array, ""]:
        """Whether an output lies at the end of a step."""
        last = self.outputs.shape[0] - 1
        time = self.outputs[jnp.clip(output, 0, last)]
        _, end, following = self.span(i)
        lies = (end <= time) & (time <= following)
        return lies & (output >= 0) & (output <= last) & (i < self.count)

    def last_of(self, output: Array) -> Array:
        """Of outputs at one time, the last: only it is shown."""
        return self._among(output, "right") - 1

    def before(self, output: Array) -> Array:
        """The last output at an earlier time."""
        return self._among(output, "left") - 1

    def _among(self, output: Array, side: str) -> Array:
        time = self.outputs[jnp.clip(output, 0, self.outputs.shape[0] - 1)]
        return jnp.searchsorted(self.outputs, time, side=side).astype(int)

    @property
    def way(self) -> Way:
        """The same for the compiled loop."""
        ends, behind = self.landings
        jumps = jnp.stack([ends[:0], ends[:0]] if behind is None else [ends, behind])
        count = self.count.astype(self.record.dtype)
        return Way(self.record, count, self.sense, self.outputs, jumps)

    @property
    def turns(self) -> Array:
        """How many steps a loop takes: the same for all lanes of a batch.

        One that is done stands still until the others are. So the loop's counter is
        one number, and writing a row of an array does not become a scatter.
        """
        return most(self.count)


@jax.custom_batching.custom_vmap
def most(x: Array) -> Array:
    """A whole number, in a batch the largest."""
    return x


@most.def_vmap
def _most_of_batch(size: int, batched: list[bool], x: Array) -> tuple[Array, bool]:
    del size
    return most(jnp.max(x) if batched[0] else x), False
