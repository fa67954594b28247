"""Runs that change between rolling, slipping and flight, for ``engine.py``.

A function of one number for each: first results, tangents and gradients, and batches.
"""

import statistics
import time

BATCH = 1000  # motions
NAMES = ("bowling ball", "shaken plate", "disc slips and grips", "bounces in a bowl")


def motions():
    """Of each name ``run(x)(method)``, and x, a speed [m/s]."""
    import jax.numpy as jnp
    import numpy as np

    import rollkane as rk

    R, MASS = 0.11, 6.0
    up, still = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    ball = rk.Body(MASS, 0.4 * MASS * R**2 * np.eye(3), rk.Sphere(R))
    lane = rk.Scene(ball)
    rate = 2.0 * np.pi * 8.6115
    moves = lambda t: 0.005025 * jnp.sin(rate * t) * jnp.array([0.0, 0.0, 1.0])
    plate = rk.Scene(ball, rk.Base(rk.Plane(), rk.BaseMotion(moves)))  # 1.5 g
    bowl = rk.Scene(ball, rk.Base(rk.Graph(lambda x, y: 0.5 * (x * x + y * y))))
    coin = rk.Scene(rk.Body(1.0, np.diag([0.0025, 0.0025, 0.005]), rk.Ring(0.1)))
    on_edge = (np.cos(np.pi / 4), np.sin(np.pi / 4), 0.0, 0.0)

    def run(scene, start, until, **modes):
        asked = jnp.array([0.0, until])
        return lambda method: rk.simulate(
            scene, start, asked, modes=rk.Modes(**modes), rtol=1e-9, method=method
        )

    slips = rk.Slipping(rk.CoulombFriction(0.2))
    sliding = lambda body, where, v: rk.place(
        *(rk.Scene(body, contact=slips), where, still, still), velocity=v
    )
    bounces = {"friction": 0.3, "restitution": 0.5}
    along = lambda v: jnp.stack([v, 0.0 * v, 0.0 * v])
    known = {
        "bowling ball": lambda v: run(
            lane, sliding(ball, up, along(v)), 3.0, friction=0.2
        ),
        "shaken plate": lambda v: run(
            plate, rk.release(plate, up, still, (0.0, 0.0, R + 0.03), along(v)), 1.0,
            **bounces,
        ),
        "disc slips and grips": lambda v: run(
            coin, sliding(coin.body, on_edge, along(v)), 2.0, friction=0.2
        ),
        "bounces in a bowl": lambda v: run(
            bowl, rk.release(bowl, up, still, (0.0, 0.0, 0.6), along(v)), 1.0, **bounces
        ),
    }  # fmt: skip
    speeds = dict(zip(NAMES, (8.0, 0.3, 2.0, 0.5), strict=True))
    return {name: (known[name], jnp.asarray(speeds[name])) for name in NAMES}


def first_of(name, what, method):
    """Time to the first result [s] of one kind, and of a further one [s]."""
    import jax

    run, x = motions()[name]
    end = lambda x: run(x)(method).final_state.parts.angular_velocity[1]
    function = {
        "value": end,
        "tangent": lambda x: jax.jvp(end, (x,), (x,))[1],
        "gradient": jax.grad(end),
    }[what]
    call = jax.jit(function)
    jax.block_until_ready(jax.jit(lambda x: 2.0 * x)(x))  # what JAX itself begins with
    began = time.perf_counter()
    jax.block_until_ready(call(x))
    first, spans = time.perf_counter() - began, []
    for _ in range(9):
        began = time.perf_counter()
        jax.block_until_ready(call(x))
        spans.append(time.perf_counter() - began)
    return first, statistics.median(spans)


def batch_of(name, method, count):
    """Motions a second, of a batch at speeds that differ."""
    import jax
    import jax.numpy as jnp

    run, x = motions()[name]
    end = lambda x: run(x)(method).final_state.parts.angular_velocity
    many, xs = jax.jit(jax.vmap(end)), x * jnp.linspace(0.9, 1.1, count)
    jax.block_until_ready(many(xs))
    spans = []
    for _ in range(3):
        began = time.perf_counter()
        jax.block_until_ready(many(xs))
        spans.append(time.perf_counter() - began)
    return count / statistics.median(spans)


def measured(given):
    """What ``name/what/method`` or ``name/batch/method/count`` asks for."""
    name, what, method, *count = given.split("/")
    if what == "batch":
        return batch_of(name, method, int(count[0]))
    return first_of(name, what, method)


def table(inner):
    """A row for each motion; ``inner(given, cache)`` measures in another process."""
    import tempfile

    rows = []
    for name in NAMES:
        for what in ("value", "tangent", "gradient"):
            row = {"motion": name, "of its last spin": what}
            for method in ("auto", "diffrax"):
                with tempfile.TemporaryDirectory() as folder:
                    first, again = inner(f"{name}/{what}/{method}", folder)
                row |= {f"{method}, first s": first, f"{method}, ms": 1e3 * again}
            rows.append(row)
    return rows


def batches(inner):
    """Motions a second in a batch, of each."""
    rows = []
    for name in NAMES:
        row: dict = {"motion": name}
        # XLA steps all members of a batch together: fewer of them show it
        for method, count in (("auto", BATCH), ("diffrax", BATCH // 10)):
            row[method] = inner(f"{name}/batch/{method}/{count}", None)
        rows.append(row | {"ratio": row["auto"] / row["diffrax"]})
    return rows
