"""The loop in C: what it can compute, and what it refuses."""

import os
import shutil
import subprocess

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from rollkane.codegen import LaneLoop, NoCompilerError, Queue, Stops
from rollkane.codegen import compiler as compilers
from rollkane.codegen.scalar_program import NotElementwiseError
from rollkane.codegen.tableau import weights_of

from ..whole_numbers import NARROW, least_and_most, noise, wrapping

TABLE, KNOTS = np.sin(np.arange(9.0)), np.linspace(-0.4, 0.6, 9)
PLACES = np.arange(12.0).reshape(4, 3) ** 0.5


def interpolated(x):
    """Of a table, linearly: an index that is computed, beyond both ends, too."""
    place = jnp.floor(5.0 * x).astype(int) + 2
    table, share = jnp.asarray(TABLE, x.dtype), 5.0 * x - jnp.floor(5.0 * x)
    return table[place] * (1.0 - share) + table[jnp.clip(place + 1, 0, 8)] * share


def in_turns(x):
    """A loop of known length, over rows and backwards."""
    rows = jnp.asarray(TABLE[:6].reshape(3, 2), x.dtype)
    step = lambda c, row: (0.5 * c + row[0] * x, c - row[1])
    end, seen = jax.lax.scan(step, x, rows, reverse=True)
    return end + jnp.sum(seen) * 0.1 + jax.lax.fori_loop(0, 3, lambda i, c: c * x, x)


# a bounded rate from each operation that the C program knows, each of one number
OPERATIONS = [
    lambda y, t: jnp.sin(y) * jnp.cos(t),
    lambda y, t: jnp.tan(0.5 * jnp.tanh(y)),
    lambda y, t: jnp.exp(-jnp.abs(y)) + jnp.expm1(-jnp.abs(y)),
    lambda y, t: jnp.log(1.0 + y * y) - jnp.log1p(y * y) / (2.0 + y**2) ** 3,
    lambda y, t: (1.0 + y * y) ** -2 + jnp.sqrt(1.0 + y * y),
    lambda y, t: jax.lax.rsqrt(1.0 + y * y) * jnp.sign(y - 0.1),
    lambda y, t: jnp.arctan2(y, 1.0 + t) + jnp.arctan(y),
    lambda y, t: jnp.arcsin(0.5 * jnp.tanh(y)) - jnp.arccos(0.3 * jnp.tanh(y)),
    lambda y, t: jnp.sinh(0.1 * y) + jnp.cosh(0.1 * y) + jnp.arcsinh(y),
    lambda y, t: jnp.power(1.5 + jnp.tanh(y), 0.7) + jnp.cbrt(1.0 + y * y),
    lambda y, t: jnp.where((y > 0.2) & ~(t > 0.5), 0.4, -0.3 * y),
    lambda y, t: jnp.where((y <= 0.2) | (t >= 0.5), y, jnp.minimum(y, 0.1)),
    lambda y, t: jnp.maximum(y, t) - jnp.clip(y, -0.2, 0.3),
    lambda y, t: (y < t).astype(y.dtype) - jnp.isfinite(y).astype(y.dtype),
    lambda y, t: jnp.floor(3.0 * jnp.sin(t)) + jnp.ceil(t) + jax.nn.sigmoid(y),
    lambda y, t: jnp.exp2(-y * y) + (y != 0.0).astype(y.dtype) + (-y),
    lambda y, t: jnp.arctanh(0.3 * jnp.cos(y)) + jnp.arccosh(2.0 + y * y),
    lambda y, t: jax.lax.rem(y + 5.0, jnp.full_like(y, 0.7)) - jax.lax.stop_gradient(y),
    lambda y, t: interpolated(y),
    lambda y, t: jnp.sum(
        jax.lax.dynamic_slice(
            jnp.asarray(PLACES, y.dtype),
            (jnp.asarray(1), (4.0 * y).astype(int)),
            (2, 2),
        )
    ),
    lambda y, t: jax.lax.cond(y > 0.1, lambda: y * y, lambda: 0.2 - y),
    lambda y, t: jax.lax.switch(
        jnp.clip((3.0 * t).astype(int) - 1, -1, 4),
        [lambda: y, lambda: t - y, lambda: 0.3 * y],
    ),
    lambda y, t: in_turns(y),
    # along no axis
    lambda y, t: jnp.sum(-(3.0 * y).astype(int)).astype(y.dtype) * 0.1 + jnp.max(y),
]


def outer(a, b):
    """Of two vectors: a product of matrices that sums over nothing."""
    return jax.lax.dot_general(a, b, (((), ()), ((), ())))


def rates(t, y, shared, own):
    """Every operation once, and what arrays of any shape need."""
    each = jnp.stack([f(y[i], t) for i, f in enumerate(OPERATIONS)])
    turned = jnp.flip(jnp.concatenate([each[1:], each[:1]]))
    own = own + 0.1 * outer(each[:2], own)[1]
    mixed = (shared @ jnp.reshape(each, (2, 12)))[0] + jnp.sum(shared, axis=1)[1]
    spread = jnp.max(jnp.broadcast_to(own[:, None], (2, 3)), axis=0)
    padded = jnp.pad(jnp.transpose(mixed.reshape(3, 4)).reshape(12), (0, 12))
    return 0.3 * turned + 0.1 * padded + 0.1 * jnp.resize(spread, 24)


def whole(y):
    """A whole number, of either sign."""
    return jnp.floor(20.0 * y).astype(int)


# what users write functions of time with: tables, choices, whole numbers
FURTHER = [
    lambda y, t: jnp.interp(
        y, jnp.asarray(KNOTS, y.dtype), jnp.asarray(TABLE, y.dtype)
    ),
    lambda y, t: jnp.select([y < 0.1, y < 0.3], [0.2 * y, -y], y * y),
    lambda y, t: jnp.piecewise(y, [y < 0.0, y > 0.2], [lambda x: -x, lambda x: x * x]),
    lambda y, t: jax.lax.select_n(whole(0.05 * y) + 1, y, 0.3 + y, -y, y * y),
    lambda y, t: jnp.argmax(jnp.stack([y, t, 0.1 * y + 0.05])).astype(y.dtype) - y,
    lambda y, t: jnp.argmin(jnp.stack([y > 0.0, y > t, y < 0.3])).astype(y.dtype) * y,
    lambda y, t: jnp.argmin(jnp.stack([y, jnp.sqrt(y - 0.1), t])).astype(y.dtype) - y,
    lambda y, t: (
        jnp.cumsum(jnp.stack([y, t, y * y]))[1] - jnp.cumprod(jnp.stack([y, t]))[1]
    ),
    lambda y, t: jax.lax.cummax(jnp.stack([y, t, 0.1 * y]), reverse=True)[1],
    lambda y, t: jnp.round(7.0 * y) - jax.lax.round(0.5 * jnp.floor(4.0 * y)),
    lambda y, t: jax.scipy.special.erf(y) + jax.lax.lgamma(1.6 + jnp.tanh(y)),
    lambda y, t: (whole(y) // 3 - whole(y) % 7).astype(y.dtype) * 0.1,
    lambda y, t: (
        (whole(y) * abs(whole(t - y)) - jnp.sign(whole(y))).astype(y.dtype) * 0.01
    ),
    lambda y, t: jnp.where(jnp.where(y > 0.1, t > y, t < 0.5), y, -y),
    lambda y, t: jnp.searchsorted(jnp.asarray(KNOTS, y.dtype), y).astype(y.dtype) * y,
    lambda y, t: jax.lax.erfc(y) * 0.3,
    lambda y, t: jnp.stack([y, t, -y])[jnp.argmax(jnp.stack([y, t, 0.1 - y]))],
    lambda y, t: jnp.interp(
        t, jnp.asarray(KNOTS, y.dtype), y * jnp.asarray(TABLE, y.dtype)
    ),
]


def further(t, y, shared, own):
    """Of each number one of them."""
    each = [FURTHER[i % len(FURTHER)](x, t) for i, x in enumerate(y)]
    return jnp.stack([x.astype(y.dtype) for x in each])


def shape(*axes, dtype=float):
    return jax.ShapeDtypeStruct(axes, dtype)


def loop_of(derivative=rates, dtype=np.float64, lanes=None, solver=None):
    leaves = [shape(2, 2, dtype=dtype), shape(2, dtype=dtype)]
    weights = weights_of(solver or dfx.Tsit5(), "a test")
    y = shape(len(OPERATIONS), dtype=dtype)
    return LaneLoop(derivative, y, leaves, [False, True], weights, lanes)


def queue_of(count, dtype=np.float64, **changes):
    random = np.random.default_rng(4)
    n = len(OPERATIONS)
    queue = Queue(
        starts=random.uniform(-0.5, 0.5, (count, n)).astype(dtype),
        atol=np.full((count, n), 1e-9, dtype),
        first_steps=np.full(count, 1e-3, dtype),
        own=random.uniform(-1.0, 1.0, (count, 2)).astype(dtype),
        shared=np.array([0.3, -0.2, 0.1, 0.5], dtype),
        time=0.0,
        rtol=1e-7,
        dtmin=1e-14,
        max_steps=10_000,
    )
    return queue._replace(**changes)


STOPS = Stops(np.array([0.4, 1.0]), np.array([0.4, 1.0]), np.array([0, 1]), 2)


def step_by_jax(queue, i, derivative=rates):
    """One step of one motion, written out."""
    weights = weights_of(dfx.Tsit5(), "a test")
    shared, own = queue.shared.reshape(2, 2), queue.own[i]
    h, y = queue.first_steps[i], queue.starts[i]
    f = lambda node, y: np.asarray(derivative(node * h, y, shared, own))
    stages = [f(0.0, y)]
    for row, node in zip(weights.rows, weights.nodes, strict=True):
        at = y + h * sum(w * k for w, k in zip(row, stages, strict=True))
        stages.append(f(node, at))
    return at


def steps_of(derivative, dtype, lanes=None):
    """Ends of one step of 64 motions, in C and by JAX, and how far the latter moved."""
    queue = queue_of(64, dtype)
    tolerant = np.full_like(queue.atol, 1e9)
    steps = np.full_like(queue.first_steps, 0.1)
    queue = queue._replace(max_steps=1, atol=tolerant, first_steps=steps)
    found = loop_of(derivative, dtype, lanes).run(queue, STOPS).final_y
    by_jax = jax.jit(derivative)
    ends = np.stack([step_by_jax(queue, i, by_jax) for i in range(64)])
    return found, ends, ends - queue.starts


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_every_operation_gives_what_jax_gives(dtype):
    """One step of 0.1 s, whatever its error: equal to some tens of roundings."""
    found, ends, moved = steps_of(rates, dtype)
    assert found.dtype == dtype
    close = 50 * np.finfo(dtype).eps
    np.testing.assert_allclose(found, ends, rtol=0, atol=close)
    assert np.ptp(moved, axis=0).min() > 1e-4  # the rates do differ


@pytest.mark.parametrize("lanes", [1, None])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_tables_choices_and_whole_numbers_give_what_jax_gives(dtype, lanes):
    """Likewise, one number a lane and several."""
    found, ends, moved = steps_of(further, dtype, lanes)
    close = 50 * np.finfo(dtype).eps
    np.testing.assert_allclose(found, ends, rtol=0, atol=close)
    assert np.isfinite(ends).all()
    assert np.ptp(moved, axis=0).min() > 1e-4


@pytest.mark.parametrize("lanes", [1, None])
@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_whole_numbers_wrap_as_in_xla(dtype, lanes):
    """Was: computed as real numbers, so that a noise of whole ones was another."""
    half = len(OPERATIONS) // 2

    def rates(t, y, shared, own):
        del t, shared, own
        kinds = *NARROW, "int64"
        found = [wrapping(y[i], kind, 300.0) for i, kind in enumerate(kinds)]
        every = jnp.concatenate([*found, least_and_most(y[7]), noise(y[8])[None]])
        # each number has its own weight: none makes up for another
        weighted = jnp.cos(jnp.arange(every.size, dtype=y.dtype)) * every
        padded = jnp.pad(weighted, (0, -every.size % half))
        # what they are numbers of stays, so that no stage moves where they jump
        return jnp.pad(jnp.sum(padded.reshape(-1, half), axis=0), (half, 0))

    found, ends, moved = steps_of(rates, dtype, lanes)
    close = 50 * np.finfo(dtype).eps  # sums of some ten parts of about one
    np.testing.assert_allclose(found, ends, rtol=0, atol=close)
    assert np.ptp(moved[:, half:], axis=0).min() > 1e-3


def test_numbers_that_c_does_not_have_are_refused():
    """Complex ones are no real ones, and 64 bits with a sign end at 2^63."""
    for f in (
        lambda y: jnp.abs(jnp.sqrt((y - 0.5).astype(complex))),
        lambda y: y.astype(jnp.uint64).astype(y.dtype),
        lambda y: jax.lax.population_count(y.astype(int)).astype(y.dtype),
    ):
        rates = lambda t, y, shared, own, f=f: f(y)
        with pytest.raises(NotElementwiseError):
            loop_of(rates)


def test_outputs_are_landed_on():
    results = loop_of().run(queue_of(3), STOPS)
    np.testing.assert_array_equal(results.y[:, 1], results.final_y)
    assert np.isfinite(results.y).all()
    earlier = Stops(np.array([0.4]), np.array([0.4]), np.array([0]), 1)
    end = loop_of().run(queue_of(3), earlier).final_y
    # other steps on the way: rtol 1e-7, and rates that jump
    np.testing.assert_allclose(results.y[:, 0], end, rtol=0, atol=1e-4)


@pytest.mark.parametrize("lanes", [1, 2, 8])
def test_lanes_do_not_know_of_each_other(lanes):
    queue = queue_of(5)
    together = loop_of(lanes=lanes).run(queue, STOPS)
    alone = loop_of(lanes=lanes).run(
        queue._replace(
            starts=queue.starts[3:4],
            own=queue.own[3:4],
            atol=queue.atol[3:4],
            first_steps=queue.first_steps[3:4],
        ),
        STOPS,
    )
    np.testing.assert_array_equal(together.y[3], alone.y[0])
    assert together.steps[3] == alone.steps[0]


def test_no_lane_waits_for_another():
    """Motions of 1 to 50 times the steps: idle lanes are those of the queue's end."""
    decay = lambda t, y, shared, own: -jnp.exp(own[0]) * (y - jnp.sin(own[0] * t))
    own = np.linspace(0.0, 4.0, 400)[:, None] * np.ones(2)
    loop = loop_of(decay)
    results = loop.run(queue_of(400, own=own), STOPS)
    tried = results.steps + results.rejected_steps
    assert tried.max() > 4 * tried.min()
    # at the end each lane may wait for the longest motion
    assert results.turns * loop.lanes <= tried.sum() + loop.lanes * tried.max()


def test_codes():
    from rollkane import Code

    nan = queue_of(3)
    nan.starts[1] = np.nan
    results = loop_of().run(nan, STOPS)
    assert results.code.tolist() == [0, Code.BAD_START, 0]
    assert np.isnan(results.y[1]).all()
    few = loop_of().run(queue_of(3, max_steps=4), STOPS)
    assert few.code.tolist() == [Code.MAX_STEPS] * 3
    assert (few.steps + few.rejected_steps == 4).all()
    blowing = lambda t, y, shared, own: y * y
    up = loop_of(blowing).run(queue_of(2, starts=np.full((2, 24), 2.0)), STOPS)
    assert up.code.tolist() == [Code.STEP_TOO_SMALL] * 2
    np.testing.assert_allclose(up.final_time, 0.5, rtol=1e-6)  # 1 / (1/2 - t)


@pytest.mark.parametrize(
    ("derivative", "says"),
    [
        (lambda t, y, a, b: jnp.sort(y), "sort"),
        (
            lambda t, y, a, b: jax.lax.fori_loop(0, 4000, lambda i, c: -c, y),
            "long scan",
        ),
        (lambda t, y, a, b: jax.lax.while_loop(jnp.any, lambda c: c - 1, y), "while"),
        (
            lambda t, y, a, b: y * jnp.resize(y, 40)[t.astype(int)],
            "among numbers that are computed",
        ),
        (lambda t, y, a, b: y.at[jnp.argsort(y)[:2]].set(t), "scatter|sort"),
        (lambda t, y, a, b: y * jnp.linalg.eigvalsh(jnp.eye(2) + t)[1], "eigh"),
    ],
    ids=["sort", "scan", "while", "lookup", "scatter", "eigenvalues"],
)
def test_more_than_arithmetic_is_refused(derivative, says):
    with pytest.raises(NotElementwiseError, match=says):
        loop_of(derivative)


def test_without_a_compiler(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("CC", "no-such-compiler")
    compilers._compiler.cache_clear()
    with pytest.raises(
        NoCompilerError, match=r'install one, or `pip install "rollkane\[compiler\]"`'
    ):
        loop_of()
    monkeypatch.undo()
    compilers._compiler.cache_clear()
    loop_of()


# stands for the package: its compiler is the system's
ZIGLANG = """
import os, sys
assert sys.argv[1] == "cc", sys.argv
for name in ("ZIG_LOCAL_CACHE_DIR", "ZIG_GLOBAL_CACHE_DIR", "TMPDIR"):
    assert "rollkane" in os.environ[name], name
os.execv({compiler!r}, [{compiler!r}, *sys.argv[2:]])
"""


def test_a_compiler_from_pip(monkeypatch, tmp_path):
    """Where the system has none; its own files are kept in the cache folder."""
    compiler = shutil.which("cc") or shutil.which("gcc")
    package, folder = tmp_path / "ziglang", tmp_path / "rollkane"
    package.mkdir()
    (package / "__init__.py").write_text("")
    (package / "__main__.py").write_text(ZIGLANG.format(compiler=compiler))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setenv("ROLLKANE_CACHE", str(folder))
    monkeypatch.syspath_prepend(str(tmp_path))
    tools = tmp_path / "tools"
    tools.mkdir()
    for name in ("as", "ld"):  # what the system's compiler calls
        (tools / name).symlink_to(shutil.which(name))
    monkeypatch.setenv("PATH", str(tools))
    monkeypatch.delenv("CC", raising=False)
    compilers._compiler.cache_clear()
    assert compilers.compiler_command()[1:4] == ("-m", "ziglang", "cc")
    results = loop_of().run(queue_of(3), STOPS)
    assert results.code.tolist() == [0, 0, 0]
    assert [x.suffix for x in folder.iterdir()] == [".so"]
    compilers._compiler.cache_clear()


def test_flags_of_the_user_s(monkeypatch):
    """They stand behind all others, and change time alone."""
    ends = {}
    for flags in ("-O0", "-O3", '-O1 -D"A=1 2"'):
        monkeypatch.setenv("ROLLKANE_CFLAGS", flags)
        ends[flags] = loop_of().run(queue_of(3), STOPS).final_y
    for end in ends.values():
        np.testing.assert_array_equal(end, ends["-O3"])
    assert compilers.compiler_command()[-2:] == ("-O1", "-DA=1 2")
    assert compilers.Program.of("int x;", effort="-O2").command[-3:] == (
        "-O2",
        "-O1",
        "-DA=1 2",
    )


@pytest.mark.parametrize(
    ("flags", "says"),
    [
        ("-fno-such-flag", r"-fno-such-flag: set ROLLKANE_CFLAGS to others"),
        ("-D'A", r"ROLLKANE_CFLAGS=-D'A is no list of flags \(No closing quotation\)"),
    ],
)
def test_flags_that_no_compiler_knows(monkeypatch, flags, says):
    monkeypatch.setenv("ROLLKANE_CFLAGS", flags)
    with pytest.raises(NoCompilerError, match=says):
        loop_of()


def test_what_was_compiled_is_kept(monkeypatch, tmp_path):
    monkeypatch.setenv("ROLLKANE_CACHE", str(tmp_path))
    first = loop_of()
    (kept,) = tmp_path.iterdir()
    when = kept.stat().st_mtime_ns
    assert loop_of().source == first.source
    assert [x.stat().st_mtime_ns for x in tmp_path.iterdir()] == [when]


def test_a_cache_that_cannot_be_written(monkeypatch, tmp_path):
    """Then the folder for temporary files serves."""
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("ROLLKANE_CACHE", str(tmp_path / "file"))
    assert loop_of().lanes > 1


def test_vectors_are_as_wide_as_the_compiler_serves_them():
    """GCC keeps the parts of those wider than the processor's in memory."""
    avx, wide, clang = (
        b"#define " + x + b" 1\n" for x in (b"__AVX__", b"__AVX512F__", b"__clang__")
    )
    assert compilers._vector_of(avx) == 32
    for macros in (b"", avx + wide, avx + clang):
        assert compilers._vector_of(macros) == 64


def test_the_same_bits_by_vectors_of_any_width(monkeypatch, tmp_path):
    """Also by a compiler that knows of fewer instructions than this processor has."""
    ends = [loop_of(lanes=n).run(queue_of(9), STOPS).final_y for n in (1, 2, 4, 8)]
    macros = subprocess.run(
        [*compilers.compiler_command(), "-E", "-dM", "-x", "c", os.devnull],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    if "#define __AVX512F__ 1" in macros:
        other = tmp_path / "cc"
        command = compilers.compiler_command()[0]
        other.write_text(f'#!/bin/sh\nexec {command} "$@" -mno-avx512f\n')
        other.chmod(0o755)
        monkeypatch.setenv("CC", str(other))
        ends.append(loop_of().run(queue_of(9), STOPS).final_y)
    for end in ends[1:]:
        np.testing.assert_array_equal(end, ends[0])


def test_only_arithmetic_is_left_of_a_disc():
    """442 equations of arrays are 217 operations; a zero of the plane costs nothing."""
    from rollkane import rolling_derivative
    from rollkane.codegen.right_hand_side import lanes_source
    from rollkane.kinematics.coordinates import pack, unpack

    from .. import problems

    scene, start = problems.disc(6.0)
    leaves, tree = jax.tree.flatten(scene)
    like = jax.tree.map(lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype), start)

    def derivative(t, y, *leaves):
        scene = jax.tree.unflatten(tree, leaves)
        return pack(rolling_derivative(scene, t, unpack(y, like)))

    kinds = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in leaves]
    source = lanes_source(
        derivative, jax.eval_shape(pack, like), kinds, [False] * len(kinds)
    )
    text = source.functions.text
    per_lane = text.count("const row s")
    per_call = text.count("const real b") - text.count("] = (real)b")
    assert per_lane <= 220, per_lane
    assert per_call <= 60, per_call
