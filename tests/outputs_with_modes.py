"""Whether a run with changes of the contact obeys mechanics, from its outputs alone.

As ``outputs_alone`` for one law: Newton's and Euler's equations, the contact and its
friction within each mode, by stencils; where a mode begins, what has to hold there: a
lift-off without normal force, a slip that begins at the edge of the friction cone, a
landing whose impulse acts where body and base touch, and is that of Routh's and
Stronge's equations as SciPy integrates them. Of rollkane only outputs are used.
"""

import contextlib
from collections.abc import Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq

import rollkane as rk

from . import outputs_alone
from .carried_systems import Seen, System, skew
from .impact_by_scipy import impact
from .outputs_alone import BASES, BODIES, FIRST, GRAVITY, SECOND

DURATION = 0.8  # s, of a run
PARTS, CHANGES = 8, 12  # of a run that are looked at, most
SHARES = (0.08, 0.5, 0.92)  # of a part, where it is
STEPS = (1.0, 1 / 3, 1 / 9, 1 / 27)  # of the longest stencil that the part has room for
SHORTEST_PART = 2e-3  # s
BESIDE = 2.5e-7 * np.array([-3, -2, -1, 1, 2, 3])  # s, of a change
OUTPUTS = PARTS * len(SHARES) * len(STEPS) * 9 + CHANGES * 6 + 1
# Values at a change are continued from three outputs of each side by parabolas, to
# 2e-20 s^3 times a third derivative, and six roundings of places of a metre: 1e-15 m,
# 1e-14 N or m/s (forces of 100 N, turns of 10 rad/s) where nothing is steep. Forces
# turn by their own size within 1e-5 s where a slip ends or begins (docs/theory.md,
# 8.5): there a third derivative is 1e15 times it, and a parabola is right to 1e-3.
FOUND, STEEP = 1e-6, 2e-3
# The least of four stencils has an error of rounding (outputs_alone.RESIDUAL), or at
# the shortest part, of 4e-5 s a step, of 6 x 2e-16 m / (4e-5 s)^2 = 8e-7 m/s^2 of 10.
RESIDUAL = 1e-6


class Faults:
    """What was found, by name: the largest of its kind."""

    def __init__(self):
        self.found: dict[str, float] = {}

    def see(self, name: str, size: Any) -> None:
        """Remember the largest; what is no number is the largest of all."""
        size = float(size) if np.isfinite(size) else np.inf
        self.found[name] = max(size, self.found.get(name, -np.inf))


class Ran(NamedTuple):
    """A run: when its modes began, which they were, and its outputs by name."""

    code: int
    edges: np.ndarray
    modes: list[int]
    out: dict[str, np.ndarray]


NAMES = ("position", "orientation", "angular_velocity", "velocity", "contact_on_base")
NAMES += ("contact_force", "energy", "slip", "mode", "alpha", "alpha_dot")


@eqx.filter_jit
def _outputs(run: rk.Trajectory) -> dict:
    return {name: getattr(run, name) for name in NAMES}


def ran(scene: rk.Scene, start: Any, modes: rk.Modes, times: np.ndarray) -> Ran:
    """A run, as tight as its method takes it."""
    run = rk.simulate(scene, start, times, modes=modes, rtol=3e-13, atol=1e-14)
    count = int(run.switches.count)
    began = np.asarray(run.switches.time)[:count]
    edges = np.concatenate([[0.0], began, [float(run.final_time)]])
    out = {name: np.asarray(x) for name, x in _outputs(run).items()}
    first = int(run.switches.before[0]) if count else int(out["mode"][0])
    return Ran(
        int(run.code), edges, [first, *np.asarray(run.switches.after)[:count]], out
    )


class Place(NamedTuple):
    """A scene's names and modes, at one moment of a run.

    Attributes:
        law: Of its contact.
        body: Its shape.
        base: Its base's.
        motion: Of its base.
        modes: Its changes.
        system: The body, with what it carries.
    """

    law: str
    body: str
    base: str
    motion: str
    modes: rk.Modes
    system: System

    def base_at(self, t: float) -> tuple[np.ndarray, ...]:
        """Rotation and origin of the base, and their rates."""
        position, rotation = (
            (lambda t: 0.0 * jnp.ones(3) * t),
            (lambda t: jnp.eye(3) + 0.0 * t),
        )
        if self.motion in ("sway", "rock"):
            position = outputs_alone._swaying
        if self.motion == "rock":
            rotation = outputs_alone._rocking
        if self.motion == "spin":
            rotation = _spinning
        found = [
            jax.jvp(f, (jnp.asarray(t),), (jnp.asarray(1.0),))
            for f in (rotation, position)
        ]
        (A, dA), (o, do) = ((np.asarray(x), np.asarray(y)) for x, y in found)
        return A, o, dA, do

    def base_velocity(self, t: float, place: np.ndarray) -> np.ndarray:
        A, o, dA, do = self.base_at(t)
        return do + dA @ A.T @ (place - o)

    def normal(self, t: float, R, r, place: np.ndarray) -> np.ndarray:
        """Out of the base, fixed axes; an edge's is that of the body."""
        base, body = BASES[self.base][1], BODIES[self.body][1]
        if base.edge:
            return -R @ body.normal((R.T @ (place - r))[None])[0]
        A, o, *_ = self.base_at(t)
        return A @ base.normal((A.T @ (place - o))[None])[0]

    def contact(self, t: float, on_base: np.ndarray) -> np.ndarray:
        A, o, *_ = self.base_at(t)
        return o + A @ on_base

    def levels(self, t: float, R, r, places) -> tuple[np.ndarray, np.ndarray]:
        """Of body and base, at places."""
        A, o, *_ = self.base_at(t)
        body = BODIES[self.body][1].level((places - r) @ R)
        return body, BASES[self.base][1].level((places - o) @ A)


def _spinning(t):
    c, s, one = jnp.cos(1.2 * t), jnp.sin(1.2 * t), jnp.ones_like(t)
    return jnp.stack([c, -s, 0 * s, s, c, 0 * s, 0 * s, 0 * s, one]).reshape(3, 3)


def examined(scene: rk.Scene, start: Any, place: Place) -> tuple[Ran, dict]:
    """Run a scene and check it by its outputs: the run, and faults by their names."""
    seen = Faults()
    whole = ran(scene, start, place.modes, np.linspace(0.0, DURATION, OUTPUTS))
    _everywhere(seen, place, whole)
    looks = [*_windows(whole), *_changes(whole)]
    if not looks:
        return whole, seen.found
    times = np.concatenate([look.times for look in looks])
    order = np.argsort(times, kind="stable")
    behind = np.linspace(DURATION, DURATION + 0.1, OUTPUTS - len(times))[1:]
    asked = np.concatenate([[0.0], times[order], behind])
    for k in range(1, len(asked)):  # none twice
        asked[k] = max(asked[k], np.nextafter(asked[k - 1], np.inf))
    close = ran(scene, start, place.modes, asked)
    # other outputs, other steps: the same motion. One that ends differs by its end
    count = min(len(whole.edges), len(close.edges)) - 1
    apart = np.abs(whole.edges[:count] - close.edges[:count])
    seen.see("changes at other times", apart.max())
    rows = np.empty(len(times), int)
    rows[order] = np.arange(1, len(times) + 1)
    least: dict[tuple[str, float, int], float] = {}
    for look, part in zip(looks, np.split(rows, _ends(looks)), strict=True):
        out = {name: x[part] for name, x in close.out.items()}
        if not np.isfinite(out["energy"]).all():
            continue
        if look.change is not None:
            _changed(seen, place, out, look)
            continue
        for name, x in _within(place, out, look).items():
            key = name, look.time, look.mode
            least[key] = min(x, least.get(key, np.inf))
    for (name, _, mode), x in least.items():
        seen.see(f"{name}, {rk.Mode(mode).name.lower()}", x)
    return whole, seen.found


class Look(NamedTuple):
    """Times at which a run is looked at, in the middle of a mode or at its change."""

    time: float
    times: np.ndarray
    mode: int
    step: float = 0.0
    change: int | None = None


def _ends(looks: list[Look]) -> np.ndarray:
    return np.cumsum([len(look.times) for look in looks])[:-1]


def _windows(run: Ran) -> Iterator[Look]:
    """Stencils within the longest parts of one mode."""
    parts = zip(run.edges[:-1], run.edges[1:], run.modes, strict=True)
    long = [p for p in parts if p[1] - p[0] > SHORTEST_PART]
    for low, high, mode in sorted(long, key=lambda p: p[0] - p[1])[:PARTS]:
        for share in SHARES:
            t = low + share * (high - low)
            room = min(outputs_alone.LONGEST, 0.9 * min(t - low, high - t) / 4)
            for step in room * np.array(STEPS):
                yield Look(t, t + step * np.arange(-4, 5), mode, step)


def _changes(run: Ran) -> Iterator[Look]:
    """Outputs right before and behind changes that are by themselves."""
    alone = np.diff(run.edges) > 10 * BESIDE[-1]
    inner = np.flatnonzero(alone[:-1] & alone[1:])
    for k in inner[:CHANGES]:
        t = run.edges[k + 1]
        yield Look(t, t + BESIDE, run.modes[k], change=run.modes[k + 1])


def _within(place: Place, out: dict, look: Look) -> dict[str, float]:
    """Residuals in the middle of a stencil, of the sizes of their terms."""
    t, h, system = look.time, look.step, place.system
    first = lambda x: np.tensordot(FIRST, x, 1) / h
    R, w, r = (
        outputs_alone._matrices(out["orientation"]),
        *(out[name] for name in ("angular_velocity", "position")),
    )
    flies, force = look.mode == rk.Mode.FLYING, out["contact_force"][4]
    at = r[4] if flies else place.contact(t, out["contact_on_base"][4])
    pull, torque, needed = _balance(system, (t, h, R, w, r), out, at)
    size = np.linalg.norm(force) + 10 * system.mass
    found = {"Newton": np.abs(pull - force).max() / size}
    turning = first(R) @ R[4].T
    spin = np.array([turning[2, 1], turning[0, 2], turning[1, 0]])
    fast = 1 + np.linalg.norm(spin)
    found["turning"] = np.abs(spin - w[4]).max() / fast
    if system.count:
        alpha, rate = out["alpha"], out["alpha_dot"][4]
        most = 1 + np.abs(rate).max()
        found["turning, alpha"] = np.abs(first(alpha) - rate).max() / most
        given = system.force(alpha[4], rate)
        found["Newton, alpha"] = np.abs(needed - given).max() / (0.3 * size)
    if flies:
        found["force"] = np.abs(force).max()
        return found | {"Euler": np.abs(torque).max() / (0.3 * size)}
    n = place.normal(t, R[4], r[4], at)
    if place.law == "rubber" and look.mode == rk.Mode.ROLLING:
        torque -= (torque @ n) * n  # whatever it needs
    found["Euler"] = np.abs(torque).max() / (0.3 * size)
    velocity = first(r) + np.cross(spin, at - r[4]) - place.base_velocity(t, at)
    slip = out["slip"][4]
    found["slip"] = np.abs(velocity - slip).max() / fast
    speed, press = np.linalg.norm(slip), force @ n
    if look.mode == rk.Mode.ROLLING:
        assert speed == 0.0
    elif speed > 1e-6:  # below, forces are as they turn to the slip's end
        wanted = -float(place.modes.friction) * press * slip / speed
        found["friction"] = np.abs(force - press * n - wanted).max() / size
    if place.motion == "rest" and not system.parts:
        gain, power = first(out["energy"]), force @ slip
        found["power"] = abs(gain - power) / (
            1 + abs(power) + np.abs(out["energy"]).max()
        )
    return found


def _balance(system: System, motion: tuple, out: dict, at: np.ndarray) -> tuple:
    """What moves the masses: force, torque about a place, generalized forces."""
    t, h, R, w, r = motion
    times = t + h * np.arange(-4, 5)
    seen = system.at(times, out["alpha"], out["alpha_dot"])
    pull, torque, needed = np.zeros(3), np.zeros(3), np.zeros(system.count)
    for item, x in zip(system.items, seen, strict=True):
        place = r + np.einsum("tij,tj->ti", R, x.place)
        push = item.mass * (np.tensordot(SECOND, place, 1) / h**2 - GRAVITY)
        pull += push
        torque += np.cross(place[4] - at, push)
        needed += push @ R[4] @ x.slopes[4]
        if item.inertia is not None:
            A, spin = R @ x.rotation, w + np.einsum("tij,tj->ti", R, x.spin)
            own = np.einsum("tij,jk,tlk,tl->ti", A, item.inertia, A, spin)
            turn = np.tensordot(FIRST, own, 1) / h
            torque += turn
            needed += turn @ R[4] @ x.turns[4]
    return pull, torque, needed


def _everywhere(seen: Faults, place: Place, run: Ran) -> None:
    """At outputs all over a run: forces in the cone, and no depth in flight."""
    times = np.linspace(0.0, DURATION, OUTPUTS)
    near = np.abs(times[:, None] - run.edges[None, 1:]).min(axis=1) < 1e-9
    rows = np.flatnonzero(np.isfinite(run.out["energy"]) & ~near)[::5]
    mode = np.asarray(run.modes)[np.searchsorted(run.edges[1:-1], times, side="right")]
    held = float(place.modes.static_friction)
    for k in rows:
        assert run.out["mode"][k] == mode[k]
        R = outputs_alone._matrices(run.out["orientation"][k : k + 1])[0]
        r, t = run.out["position"][k], times[k]
        if mode[k] == rk.Mode.FLYING:
            points = r + BODIES[place.body][1].points @ R.T
            seen.see("depth in flight", -place.levels(t, R, r, points)[1].min())
            continue
        at = place.contact(t, run.out["contact_on_base"][k])
        seen.see("off the surfaces", np.abs(place.levels(t, R, r, at[None])).max())
        press, along = _parts(run.out["contact_force"][k], place.normal(t, R, r, at))
        seen.see("pull", -press)
        if mode[k] == rk.Mode.ROLLING:
            seen.see("out of the cone", (along - held * press) / (1 + press))


def _parts(force: np.ndarray, n: np.ndarray) -> tuple[float, float]:
    press = force @ n
    return press, float(np.linalg.norm(force - press * n))


def _changed(seen: Faults, place: Place, out: dict, look: Look) -> None:
    """What has to hold where one mode ends and another begins."""
    before = {name: x[:3].T @ [1, -3, 3] for name, x in out.items() if x.ndim > 1}
    after = {name: x[3:].T @ [3, -3, 1] for name, x in out.items() if x.ndim > 1}
    t = look.time
    R = outputs_alone._matrices(before["orientation"][None])[0]
    apart = lambda *names: np.concatenate([after[k] - before[k] for k in names])
    seen.see("jump", np.abs(apart("position", "alpha")).max())
    kick = apart("velocity", "angular_velocity", "alpha_dot")
    if look.mode == rk.Mode.FLYING:
        _landed(seen, place, (t, R, before, after), look.change, kick)
        return
    # rubber may end a spin at once where it grips
    if place.law != "rubber" or look.change != rk.Mode.ROLLING:
        seen.see("kick", np.abs(kick).max())
    held = float(place.modes.static_friction)

    def forces(side: dict) -> tuple[float, float]:
        at = place.contact(t, side["contact_on_base"])
        r = side["position"]
        return _parts(side["contact_force"], place.normal(t, R, r, at))

    if look.change == rk.Mode.FLYING:
        seen.see("lift-off", abs(forces(before)[0]))
    elif look.mode == rk.Mode.ROLLING:
        press, along = forces(before)
        seen.see("breakaway", abs(along - held * press))
    else:
        seen.see("slip's end", np.linalg.norm(before["slip"]))
        if look.change == rk.Mode.ROLLING:
            press, along = forces(after)
            seen.see("rolls out of the cone", along - held * press)


def _landed(seen, place, moment, change, kick) -> None:
    """An impulse that acts at the contact, and is what Routh and Stronge have it."""
    t, R, before, after = moment
    r, system = before["position"], place.system
    now = system.at(np.array([t]), before["alpha"][None], before["alpha_dot"][None])
    M = system.inertia([Seen(*(a[0] for a in x)) for x in now], R)
    pushed = M @ kick  # impulse, its torque about the origin, and none on what moves
    impulse, spin = pushed[:3], pushed[3:6]
    size = np.linalg.norm(impulse)
    sticks = place.law == "rubber" and change == rk.Mode.ROLLING
    if size < 1e-3:
        return
    if system.count:
        seen.see("impulse on what is carried", np.abs(pushed[6:]).max() / size)
    if sticks:  # its torque about the normal is not of the impulse
        return
    seen.see("impulse's torque", abs(spin @ impulse) / size**2)
    way, foot = impulse / size, r + np.cross(impulse, spin) / size**2
    along = lambda s: foot + np.multiply.outer(s, way)
    cut = int(BODIES[place.body][1].edge)  # by the surface that it passes through
    level = lambda s: float(place.levels(t, R, r, along(s)[None])[cut][0])
    tries = np.linspace(-1.0, 1.0, 4001)
    values = place.levels(t, R, r, along(tries))[cut]
    cuts = np.flatnonzero(values[:-1] * values[1:] <= 0.0)
    found = [brentq(level, tries[k], tries[k + 1], xtol=1e-15) for k in cuts]
    depths = [abs(place.levels(t, R, r, along(s)[None])[1 - cut][0]) for s in found]
    seen.see("impulse beside the contact", min(depths, default=np.inf) * size)
    if not found:
        return
    at = along(found[int(np.argmin(depths))])
    n, arm = place.normal(t, R, r, at), at - r
    moving = place.base_velocity(t, at)
    u, u_after = (
        side["velocity"] + np.cross(side["angular_velocity"], arm) - moving
        for side in (before, after)
    )
    J = np.hstack([np.eye(3), -skew(arm), np.zeros((3, system.count))])
    G = J @ np.linalg.solve(M, J.T)
    t1 = np.cross(n, np.eye(3)[np.argmin(np.abs(n))])
    axes = np.stack([t1 / np.linalg.norm(t1), np.cross(n, t1 / np.linalg.norm(t1)), n])
    numbers = axes @ G @ axes.T, axes @ u, float(place.modes.friction)
    gives = float(place.modes.restitution)
    wanted = numbers[1] + numbers[0] @ impact(*numbers, gives)
    if wanted[2] < float(place.modes.rest_speed):
        assert change != rk.Mode.FLYING
        wanted = numbers[1] + numbers[0] @ impact(*numbers, 0.0)
    off = np.abs(axes.T @ wanted - u_after).max()
    seen.see("impact", off / np.linalg.norm(u))


def carrying(scene: rk.Scene, system: System) -> rk.Scene:
    """A scene whose body carries the parts of a system."""
    known = {name: getattr(scene, name) for name in ("loads", "contact")}
    return rk.Scene(scene.body, scene.base, supported=system.parts, **known)


def released(scene: rk.Scene, base: str, seed: int, inside: tuple = ()) -> Any:
    """The first of some random starts above the base that ``release`` accepts.

    Args:
        scene: What falls.
        base: Onto what, by its name.
        seed: Of the starts.
        inside: Coordinates of what is carried, and their rates.
    """
    draw = np.random.default_rng(seed)
    for _ in range(40):
        at = np.array(BASES[base][2](*draw.uniform(-0.5, 0.5, 2)))
        way = draw.normal(size=3)  # an edge has normals all round
        up = way if BASES[base][1].edge else BASES[base][1].normal(at[None])[0]
        up = up / np.linalg.norm(up) * draw.uniform(0.5, 0.8)
        q, spin = draw.normal(size=4), 3.0 * draw.normal(size=3)
        with contextlib.suppress(rk.FieldError):
            return rk.release(
                scene,
                q / np.linalg.norm(q),
                spin,
                at + up,
                draw.normal(size=3),
                *inside,
            )
    raise AssertionError("no start was accepted")
