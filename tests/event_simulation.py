"""All changes of contact of simple motions, by closed forms and dense searches.

Nothing here is the library's. Every change is ``(time, before, after)``.
"""

from typing import NamedTuple

import numpy as np

from .event_search import (
    ANY,
    Function,
    GrazingError,
    Margin,
    Surface,
    between,
    changes,
    clearance,
    extremes,
    nearby,
    root,
    zeros,
)

ROLLING, SLIPPING, FLYING = 0, 1, 2
Events = list[tuple[float, int, int]]

# A homogeneous ball's slip changes by 1 + m r^2 / J = 7/2 of friction over mass
FREED = 3.5
LOOKS = 1e-3  # of a thrown ball [s]: every 5 mm at 5 m/s
MOST = 10_000  # events of a run; none here has a tenth of them


class _Plate(NamedTuple):
    """A plate shaken vertically, as functions of time, and what falls on it."""

    position: Function
    velocity: Function
    acceleration: Function
    restitution: float
    gravity: float
    rest_speed: float
    until: float
    margin: Margin

    def press(self, t):
        """Force on a ball that stays on the plate, by its mass."""
        return self.gravity + self.acceleration(t)

    def landing(self, turns, start, gap, speed) -> tuple[float, float] | None:
        """When the ball lands, and how fast, if it does before the end.

        Args:
            turns: Zeros of what presses.
            start: Time at which it is free [s].
            gap: Over the plate at that time [m].
            speed: Away from the plate at that time [m/s].
        """
        p, v, g = self.position(start), self.velocity(start), self.gravity

        def apart(t):
            s = t - start
            fallen = (v + speed - 0.5 * g * s) * s
            return gap + fallen - (self.position(t) - p)

        def rate(t):
            return speed - g * (t - start) - (self.velocity(t) - v)

        # the rate's derivative is what presses, but for its sign
        rests = changes(rate, between(start, turns, self.until), speed)
        knots = between(start, rests, self.until)
        values = np.append(gap, apart(knots[1:]))
        landed = np.flatnonzero(values[1:] <= 0.0)
        seen = landed[0] if len(landed) else len(knots) - 2
        lows = 1 + np.flatnonzero(values[1:] < values[:-1])
        self.margin.check("gap", values[lows[lows <= seen + 1]])
        if not len(landed):
            return None
        at = root(apart, knots[seen], knots[seen + 1], 1.0)
        return at, -float(rate(at))

    def run(self, t: float, gap: float | None, speed: float) -> Events:
        """All changes from a start in the air, or in contact (no gap)."""
        events: Events = []
        turns = zeros(self.press, t, self.until, self.margin)
        while len(events) < MOST:
            if gap is None:
                t = self._lift(turns, t)
                if not t < self.until:
                    return events
                events.append((t, ROLLING, FLYING))
                gap = speed = 0.0
            landed = self.landing(turns, t, gap, speed)
            if landed is None:
                return events
            t, approach = landed
            self.margin.check("time", self.until - t)
            speed, gap = self.restitution * approach, 0.0
            self.margin.check("speed", speed - self.rest_speed)
            rests = speed < self.rest_speed
            events.append((t, FLYING, ROLLING if rests else FLYING))
            if rests:
                gap = None
                self.margin.check("time", np.append(turns, np.inf) - t)
        raise RuntimeError("too many events")

    def _lift(self, turns, t) -> float:
        """When a contact that begins at t ends."""
        if self.press(t) < 0.0:
            return t
        later = turns[turns > t]
        lift = float(later[0]) if len(later) else np.inf
        self.margin.check("time", lift - self.until)
        return lift


def bouncing_ball(
    *plate: Function,
    height: float,
    restitution: float,
    gravity: float,
    rest_speed: float,
    until: float,
    margin: Margin = ANY,
) -> Events:
    """A ball that is let go over a plate shaken vertically.

    It rebounds with its restitution times the speed of approach; what is slower than
    the speed of rest stays in contact, until the plate would have to pull.

    Args:
        plate: Its position [m], velocity and acceleration, functions of times.
        height: Of the ball over the plate's zero [m]; at rest at t = 0.
        restitution: [1].
        gravity: [m/s^2].
        rest_speed: [m/s].
        until: End [s].
        margin: What is not drawn.
    """
    position, velocity, acceleration = plate
    numbers = restitution, gravity, rest_speed, until, margin
    given = _Plate(position, velocity, acceleration, *numbers)
    zero = np.zeros(())
    return given.run(0.0, height - float(position(zero)), -float(velocity(zero)))


def normal_force_dips(
    *plate: Function,
    restitution: float,
    gravity: float,
    rest_speed: float,
    until: float,
    margin: Margin = ANY,
) -> Events:
    """A ball that rests on a plate shaken vertically, and leaves where it is not held.

    Args:
        plate: Its position [m], velocity and acceleration, functions of times.
        restitution: [1].
        gravity: [m/s^2].
        rest_speed: [m/s].
        until: End [s].
        margin: What is not drawn.
    """
    position, velocity, acceleration = plate
    numbers = restitution, gravity, rest_speed, until, margin
    return _Plate(position, velocity, acceleration, *numbers).run(0.0, None, 0.0)


def shaken_ball(
    amplitude: float,
    frequency: float,
    friction: float,
    gravity: float,
    until: float,
    margin: Margin = ANY,
) -> Events:
    """A homogeneous ball that rests on a plate shaken sideways.

    From m v' = F and 2/5 m r^2 w' = -r F, the slip over the plate U = v - r w - V obeys
    U' = 7/2 F/m - a: it rolls with F = 2/7 m a up to mu m g, and slips with
    U' = -7/2 mu g sign(U) - a.

    Args:
        amplitude: Of x = amplitude sin(2 pi frequency t) [m].
        frequency: [Hz].
        friction: mu [1], of sticking as of sliding.
        gravity: [m/s^2].
        until: End [s].
        margin: What is not drawn.
    """
    rate = 2.0 * np.pi * frequency
    limit = FREED * friction * gravity
    velocity = lambda t: amplitude * rate * np.cos(rate * t)
    acceleration = lambda t: -amplitude * rate**2 * np.sin(rate * t)
    share = limit / (amplitude * rate**2)
    margin.check("acceleration", limit * (1.0 - 1.0 / share))
    if share >= 1.0:
        return []
    turns = np.pi * np.arange(2.0 * frequency * until + 1.0)
    onsets = (turns + np.arcsin(share)) / rate
    rests = np.sort(np.concatenate([onsets, (turns + np.pi - np.arcsin(share)) / rate]))
    events: Events = []
    t, slips = 0.0, False
    while len(events) < MOST:
        if not slips:
            t = float(onsets[onsets > t][0])
            margin.check("time", t - until)
            if t > until:
                return events
            events.append((t, ROLLING, SLIPPING))
        sign = -np.sign(acceleration(t))
        # a slip's rate has its zeros where the plate's acceleration is at the limit
        slip = lambda s, t=t, sign=sign: (
            -sign * limit * (s - t) - (velocity(s) - velocity(t))
        )
        ends = changes(slip, between(t, rests, until), sign)
        if not len(ends):
            return events
        t = float(ends[0])
        slips = bool(abs(acceleration(t)) > limit)
        margin.check("time", until - t)
        margin.check("acceleration", abs(acceleration(t)) - limit)
        events.append((t, SLIPPING, SLIPPING if slips else ROLLING))
    raise RuntimeError("too many events")


class _Slide(NamedTuple):
    """A ball that slides on an inclined plane, in closed form.

    With the slip's size S and its angle from downhill, S' = G cos - K and S angle' =
    -G sin. By p, with dp = dt/S, tan(angle/2) falls as exp(-G p), and so S and t are
    sums of exponentials of p: S = S0 (a e^-(K-G)p + b e^-(K+G)p).
    """

    speed: float
    downhill: float  # cosine of the angle from downhill at the start
    pull: float  # G [m/s^2]
    friction: float  # K [m/s^2]

    def parts(self, p):
        """Both parts of S [m/s]: their difference is the slip downhill."""
        share = 0.5 * (1.0 + self.downhill), 0.5 * (1.0 - self.downhill)
        rates = self.friction - self.pull, self.friction + self.pull
        return [
            self.speed * a * np.exp(-k * p) for a, k in zip(share, rates, strict=True)
        ]

    def time(self, p):
        """When p is reached [s]: the integral of S."""
        share = 0.5 * (1.0 + self.downhill), 0.5 * (1.0 - self.downhill)
        rates = self.friction - self.pull, self.friction + self.pull
        grown = [p if k == 0.0 else -np.expm1(-k * p) / k for k in rates]
        return self.speed * (share[0] * grown[0] + share[1] * grown[1])

    def end(self) -> float:
        """When the slip ends [s]: infinite where friction cannot hold the ball."""
        K, G = self.friction, self.pull
        if K <= G:
            return np.inf
        return float(self.speed * (K + G * self.downhill) / (K * K - G * G))

    def place(self, t: float) -> float:
        """The p that is reached at a time before the end."""
        high = 1.0 / self.speed
        while self.time(high) < t:
            high *= 2.0
        return root(lambda p: self.time(p) - t, 0.0, high, -1.0)


def _slide(slip, friction, slope, gravity) -> _Slide:
    speed = float(np.hypot(*slip))
    pull, press = gravity * np.sin(slope), gravity * np.cos(slope)
    return _Slide(speed, -slip[1] / speed, float(pull), float(FREED * friction * press))


def turning_slide(
    slip: tuple[float, float],
    friction: float,
    slope: float,
    gravity: float,
    until: float,
    margin: Margin = ANY,
) -> Events:
    """A homogeneous ball that slides on a plane which falls towards -y.

    The slip U obeys U' = g sin(slope) e - 7/2 mu g cos(slope) U/|U|, e downhill.
    It ends only where friction holds the ball, mu > 2/7 tan(slope): else it turns
    downhill and grows. (Straight uphill, where it would come through zero, is left
    out.)

    Args:
        slip: At t = 0, on axes of the plane [m/s].
        friction: mu [1], of sticking as of sliding.
        slope: [rad].
        gravity: [m/s^2].
        until: End [s].
        margin: What is not drawn.
    """
    slide = _slide(slip, friction, slope, gravity)
    end = slide.end()
    margin.check("time", end - until)
    if end < until:
        margin.check("acceleration", slide.friction - slide.pull)
        return [(end, SLIPPING, ROLLING)]
    last = slide.place(until)
    margin.check("approach", sum(slide.parts(np.linspace(0.0, last, 1001))))
    return []


def slip_of_slide(
    slip: tuple[float, float],
    friction: float,
    slope: float,
    gravity: float,
    time: float,
) -> np.ndarray:
    """The slip of :func:`turning_slide` at a time [m/s], shape (2,)."""
    slide = _slide(slip, friction, slope, gravity)
    if time >= slide.end():
        return np.zeros(2)
    down, up = slide.parts(slide.place(time))
    across = np.copysign(2.0 * np.sqrt(down * up), slip[0])
    return np.array([across, up - down])


class _Throw(NamedTuple):
    """A ball in flight over a surface."""

    height: Surface
    radius: float
    gravity: float
    start: float
    position: np.ndarray
    velocity: np.ndarray

    def center(self, times) -> np.ndarray:
        """Of the ball [m], shape (3, n)."""
        s = np.asarray(times) - self.start
        place = self.position[:, None] + self.velocity[:, None] * s
        place[2] -= 0.5 * self.gravity * s * s
        return place

    def apart(self, times) -> np.ndarray:
        """Between ball and surface [m], shape (n,)."""
        return clearance(self.height, self.center(times), self.radius)

    def landing(self, until: float, margin: Margin) -> float | None:
        """When the ball first touches, looked for in pieces of 64 times."""
        # it has just left: a hundredth of a look is 10 um at 1 m/s
        looks = self.start + LOOKS * np.append(0.01, np.arange(1.0, MOST))
        looks = np.append(looks[looks < until], until)
        for first in range(0, len(looks), 64):
            # two times on both sides, so that minima at the seams are seen
            times = looks[max(first - 2, 0) : first + 66]
            y = self.apart(times)
            lows = extremes(self.apart, times, y, below=0.1 * self.radius)
            low = self.apart(lows)
            margin.check("gap", low)
            times, y = np.append(times, lows), np.append(y, low)
            order = np.argsort(times)
            inside = np.flatnonzero(y[order] <= 0.0)
            if len(inside):
                if not inside[0]:
                    raise GrazingError("touches where it leaves")
                return root(self.apart, *times[order[inside[0] - 1 :][:2]], 1.0)
        return None


def thrown_ball(
    height: Surface,
    radius: float,
    position,
    velocity,
    *,
    restitution: float,
    gravity: float,
    until: float,
    landings: int,
    margin: Margin = ANY,
) -> Events:
    """A ball thrown over a surface at rest, without friction.

    Where its centre comes within a radius of any point of the surface, the velocity
    along the normal is reversed, times the restitution.

    Args:
        height: z of x and y [m], which takes complex numbers, too.
        radius: [m].
        position: Of the centre at t = 0 [m], shape (3,).
        velocity: [m/s], shape (3,).
        restitution: [1].
        gravity: [m/s^2].
        until: End [s].
        landings: Most landings.
        margin: What is not drawn.
    """
    r, v = np.array(position, float), np.array(velocity, float)
    events: Events = []
    t = 0.0
    while len(events) < landings:
        flight = _Throw(height, radius, gravity, t, r, v)
        at = flight.landing(until, margin)
        if at is None:
            return events
        margin.check("time", until - at)
        center = flight.center([at])
        _, distance, points = nearby(height, center, radius)
        nearest = int(np.argmin(distance))
        elsewhere = np.linalg.norm(points - points[:, [nearest]], axis=0) > 1e-3
        margin.check("gap", distance[elsewhere] - radius)
        r = center[:, 0]
        normal = (r - points[:, nearest]) / distance[nearest]
        v = v - np.array([0.0, 0.0, gravity * (at - t)])
        approach = -float(v @ normal)
        margin.check("approach", restitution * approach)
        v = v + (1.0 + restitution) * approach * normal
        t = at
        events.append((t, FLYING, FLYING))
    return events
