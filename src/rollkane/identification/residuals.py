"""What a record says about a model: weighted misfits and their exact derivatives.

A record's misfits are one function of its coordinates, compiled once for all records
and fits of the same structure. Channels with a delay have a run of their own, whose
output times move with it.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple, TypeAlias, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..codegen.compile_effort import for_many_numbers, for_one_call
from ..hybrid.modes import Mode, Switches
from ..integration.backends import may_go_natively
from ..simulation.run import simulate
from ..simulation.run_options import RunOptions
from ..validation.checks import FieldError
from .channels import AbstractChannel
from .parameters import Free, Model, Slots, Tied
from .records import Record

# Times beyond the horizon are moved close behind it, this share of the record apart:
# their samples do not count, and no program depends on the horizon.
_BEHIND = 1e-6
# A sample that a run does not reach counts as this many deviations, and what it reads.
_LOST = 10.0
# Misfits, which of them are samples, and which are reached.
_Rows: TypeAlias = tuple[Array, Array, Array]


class Group(eqx.Module):
    """Channels that one run serves.

    Attributes:
        time: Times of their samples [s], shape (T,).
        channels: By name, with the samples at these times.
        delayed: Whether the times move with the channel's delay.
        leads: Whether the run starts before the first sample.
    """

    time: Float[Array, " T"]
    channels: dict[str, AbstractChannel]
    delayed: bool = eqx.field(static=True)
    leads: bool = eqx.field(static=True)


class Residuals(NamedTuple):
    """Misfits of a model.

    Attributes:
        misfit: Over their deviations [1], shape (N,); 0 where no sample is.
        counted: Which of them are samples, shape (N,).
        reached: For which of them the run gives a number, shape (N,).
        codes: Of the runs, shape (G,).
        landings: How often a flight ends in each of them, shape (G,).
    """

    misfit: Float[Array, " N"]
    counted: Bool[Array, " N"]
    reached: Bool[Array, " N"]
    codes: Array
    landings: Array


class Linearized(eqx.Module):
    """Misfits at some parameters.

    Attributes:
        at: Misfits.
        jacobian: Their derivative by the record's coordinates, shape (N, P).
    """

    at: Residuals
    jacobian: Float[Array, "N P"]


def grouped(
    record: Record, free: tuple[Free | Tied, ...], deviations: dict[str, np.ndarray]
) -> tuple[Group, ...]:
    """A record's channels by the runs that they need.

    Args:
        record: The record.
        free: Free parameters: delays among them give runs of their own, which leave out
            the samples that may show the time before the start.
        deviations: Of channels without sigma.
    """
    time, start = np.asarray(record.time), float(record.start_time)
    largest = _delays(record, free)
    groups: list[Group] = []
    together: dict[str, AbstractChannel] = {}
    # by name, as JAX orders a dictionary: misfits come back in one row
    for name, channel in sorted(record.channels.items()):
        if channel.sigma is None:
            sigma = jnp.asarray(deviations[name])
            channel = eqx.tree_at(
                lambda c: c.sigma, channel, sigma, is_leaf=lambda x: x is None
            )
        if name not in largest:
            together[name] = channel
            continue
        kept = time - largest[name] > start
        if kept.sum() < 2:
            problem = f"leaves no samples: it may be up to {largest[name]:g} s"
            remedy = "give smaller bounds, or an earlier Record.start_time"
            raise FieldError(f"{name}.delay", "...", problem, remedy)
        channel = eqx.tree_at(lambda c: c.values, channel, channel.values[kept])
        groups.append(Group(jnp.asarray(time[kept]), {name: channel}, True, True))
    if together:
        leads = bool(start < time[0])
        groups.insert(0, Group(record.time, together, False, leads))
    return tuple(groups)


def with_delay_bounds(
    free: tuple[Free | Tied, ...], records: Sequence[Record]
) -> tuple[Free | Tied, ...]:
    """The parameters; delays without an upper bound get one: 20 samples."""

    def bounded(one: Free | Tied) -> Free | Tied:
        name, _, field = one.path.rpartition(".")
        owners = [r for r in records if name in r.channels]
        if not isinstance(one, Free) or field != "delay" or not owners:
            return one
        low, high = (None, None) if one.bounds is None else one.bounds
        low = 0.0 if low is None else low
        if high is None:
            spacing = max(float(np.median(np.diff(np.asarray(r.time)))) for r in owners)
            known = max(float(r.channels[name].delay) for r in owners)
            high = known + 20.0 * spacing
        return dataclasses.replace(one, bounds=(low, high))

    return tuple(bounded(one) for one in free)


def _delays(record: Record, free: tuple[Free | Tied, ...]) -> dict[str, float]:
    """Largest delay of every channel that has one, or may have [s]."""
    largest = {f.path: f.bounds[1] for f in free if isinstance(f, Free) and f.bounds}
    found: dict[str, float] = {}
    for name, channel in record.channels.items():
        limit = largest.get(f"{name}.delay")
        known = (
            float(channel.delay) if limit is None else float(np.max(np.asarray(limit)))
        )
        if limit is not None or known != 0.0:
            found[name] = known
    return found


def behind(time: Float[Array, " T"], horizon: float) -> np.ndarray:
    """Times with those beyond a horizon moved close behind it."""
    known = np.asarray(time)
    late = known > horizon
    if not late.any():
        return known
    kept = known[~late]
    last = max(horizon, kept[-1] if kept.size else known[0])
    step = _BEHIND * (known[-1] - known[0])
    return np.where(late, last + step * np.cumsum(late), known)


def within(
    groups: tuple[Group, ...], horizon: float
) -> tuple[tuple[Group, ...], tuple[Bool[Array, " T"], ...]]:
    """Groups up to a horizon [s], and which of their times count."""
    counts = tuple(jnp.asarray(np.asarray(g.time) <= horizon) for g in groups)
    shorter = [
        eqx.tree_at(lambda g: g.time, g, jnp.asarray(behind(g.time, horizon)))
        for g in groups
    ]
    return tuple(shorter), counts


def linearized(
    slots: Slots,
    model: Model,
    groups: tuple[Group, ...],
    counts: tuple[Bool[Array, " T"], ...],
    options: RunOptions,
    z: Float[Array, " P"],
) -> Linearized:
    """Misfits and their derivatives by a record's coordinates."""
    program = _beside_c if may_go_natively(options.method) else _by_xla
    return program(slots, model, groups, counts, options, z)


def _linearized(
    slots: Slots,
    model: Model,
    groups: tuple[Group, ...],
    counts: tuple[Bool[Array, " T"], ...],
    options: RunOptions,
    z: Float[Array, " P"],
) -> Linearized:

    def misfits(z: Array) -> tuple[Array, Residuals]:
        known = slots.applied(model, z)
        found = residuals_of(known, groups, counts, options)
        return found.misfit, found

    jacobian, found = cast(
        tuple[Array, Residuals], jax.jacfwd(misfits, has_aux=True)(z)
    )
    return Linearized(found, jacobian)


_beside_c, _by_xla = for_one_call(_linearized), for_many_numbers(_linearized)


def residuals_of(
    model: Model,
    groups: tuple[Group, ...],
    counts: tuple[Bool[Array, " T"], ...],
    options: RunOptions,
) -> Residuals:
    """Misfits of a model."""
    parts = [
        _of_group(model, group, count, options)
        for group, count in zip(groups, counts, strict=True)
    ]
    rows = _one_below_the_other([part[:3] for part in parts])
    codes, landings = (jnp.stack([part[i] for part in parts]) for i in (3, 4))
    return Residuals(*rows, codes, landings)


def _one_below_the_other(rows: Sequence[_Rows]) -> _Rows:
    misfits, counts, reaches = zip(*rows, strict=True)
    return jnp.concatenate(misfits), jnp.concatenate(counts), jnp.concatenate(reaches)


def _of_group(
    model: Model,
    group: Group,
    count: Bool[Array, " T"],
    options: RunOptions,
) -> tuple[Array, Array, Array, Array, Array]:
    """Of a group's channels and its run what :class:`Residuals` has, in order."""
    time = group.time
    if group.delayed:
        (name,) = group.channels
        time = time - model.channels[name].delay
    times = jnp.concatenate([model.time[None], time]) if group.leads else time
    run = simulate(
        model.scene,
        model.start,
        times,
        modes=model.modes,
        **options._asdict(),
    )
    found: list[_Rows] = []
    for name, samples in group.channels.items():
        # the record's samples and noise, with the parameters of the model's channel
        channel = eqx.tree_at(
            lambda c: (c.values, c.sigma),
            model.channels[name],
            (samples.values, samples.sigma),
            is_leaf=lambda x: x is None,
        )
        assert channel.sigma is not None
        predicted = run.each(channel.observed)
        predicted = predicted[1:] if group.leads else predicted
        sampled = ~jnp.isnan(samples.values)
        # misfits are not pulled back at NaN, which 0 times is NaN
        known = jnp.isfinite(predicted)
        predicted = jnp.where(known, predicted, jnp.where(sampled, samples.values, 1.0))
        filled = eqx.tree_at(
            lambda c: c.values, channel, jnp.where(sampled, samples.values, predicted)
        )
        misfit = filled.misfit(predicted) / channel.sigma[None]
        complete = jnp.all(sampled, axis=1, keepdims=True)
        whole = sampled if misfit.shape == sampled.shape else complete
        counted = jnp.broadcast_to(whole, misfit.shape) & count[:, None]
        known = (
            known if misfit.shape == known.shape else jnp.all(known, 1, keepdims=True)
        )
        reached = jnp.isfinite(misfit) & known
        size = jnp.sqrt(jnp.mean(jnp.where(sampled, samples.values, 0.0) ** 2))
        lost = _LOST + 2.0 * size / channel.sigma[None]
        finite = jnp.where(reached, misfit, lost)
        kept = jnp.where(counted, finite, 0.0)
        found.append((kept.ravel(), counted.ravel(), reached.ravel()))
    return *_one_below_the_other(found), run.code, _landings(run.switches)


def _landings(switches: Switches | None) -> Array:
    """How often a flight ends."""
    if switches is None:
        return jnp.asarray(0)
    return jnp.sum(jnp.isfinite(switches.time) & (switches.before == Mode.FLYING))
