"""Which loop takes a run, and what it says of it."""

import re
import warnings

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane import kane
from rollkane.codegen import NoCompilerError
from rollkane.codegen import compiler as compilers
from rollkane.files.scene_files.loading import builtin_scenes, load_scene
from rollkane.integration import backends as methods
from rollkane.integration import integrate as integration
from rollkane.integration.prepared import Prepared

from .. import problems

TIMES = (0.0, 0.01, 0.02)


def short(scene, start, **how):
    return rk.simulate(scene, start, TIMES, **how)


@pytest.mark.parametrize("name", builtin_scenes())
def test_every_built_in_scene_runs_natively(name):
    file = load_scene(name)
    assert file.modes is None
    run = rk.simulate(file.scene, file.start, file.times[:3])
    assert (run.method, run.why) == ("native", "")
    assert run.succeeded


@pytest.mark.parametrize(
    ("how", "why"),
    [
        ({"method": "diffrax"}, "was chosen"),
        pytest.param(
            *({"solver": dfx.Kvaerno5()}, "Kvaerno5 is none of"), marks=pytest.mark.slow
        ),
        ({"solver": dfx.Tsit5(), "adjoint": dfx.DirectAdjoint()}, "adjoint goes by"),
        ({"saveat": dfx.SaveAt(t1=True)}, "saveat goes by"),
        ({"stepsize_controller": dfx.ConstantStepSize(), "dt0": 0.01}, "stepsize_c"),
    ],
)
def test_what_goes_by_diffrax_says_why(how, why):
    run = short(*problems.disc(), **how)
    assert run.method == "diffrax"
    assert why in run.why


def bouncing(start, method="auto"):
    """A ball that is dropped with spin: it slips in its impacts, and then rolls."""
    modes = rk.Modes(friction=0.03, restitution=0.4)
    return rk.simulate(BALL, start, (0.0, 0.9), modes=modes, rtol=1e-8, method=method)


BALL = rk.Scene(rk.Body(2.0, 0.008 * np.eye(3), rk.Sphere(0.1)))


def dropped(spin):
    spin = jnp.stack([0.0 * spin, spin, 0.0 * spin])
    return rk.release(BALL, [1.0, 0.0, 0.0, 0.0], spin, [0.0, 0.0, 0.2], [0.1, 0, 0])


@pytest.mark.slow
def test_runs_with_modes_are_the_same_by_both():
    start = dropped(jnp.asarray(7.0))
    run, other = bouncing(start), bouncing(start, "diffrax")
    assert (run.method, run.why) == ("native", "")
    assert (other.method, other.why) == ("diffrax", 'method="diffrax" was chosen')
    assert run.code == other.code == 0
    assert run.switches.count == other.switches.count > 5
    assert run.steps == other.steps
    # an event's search may end a try earlier, by rounding
    assert abs(run.rejected_steps - other.rejected_steps) <= run.switches.count
    assert set(run.switches.after[: run.switches.count].tolist()) == {0, 1, 2}
    for a, b in zip(jax.tree.leaves(run.switches), jax.tree.leaves(other.switches),
                    strict=True):  # fmt: skip
        # rounding of one step, some tens of steps with eight bounces
        np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-13)


def test_batches_and_derivatives_of_runs_with_modes_are_native_too():
    end = lambda spin: bouncing(dropped(spin)).final_state.parts.angular_velocity[1]
    spins = jnp.array([3.0, 7.0, 20.0])
    one = jax.jit(end)
    many = jax.jit(jax.vmap(end)).lower(spins)
    assert len(programs_in(one.lower(spins[0]))) == 1
    # a start, steps of which those that are plain go in lanes, and an end
    assert len(programs_in(many)) == 3
    ends = many.compile()(spins)
    # rounding of some tens of steps with eight bounces
    np.testing.assert_allclose(ends, [one(spin) for spin in spins], rtol=1e-12)
    back = jax.jit(jax.vmap(jax.grad(end))).lower(spins)
    forth = jax.jit(lambda x: jax.jvp(end, (x,), (jnp.ones_like(x),))[1])
    # with their steps recorded, and then pulled back or pushed on
    assert len(programs_in(back)) == len(programs_in(forth.lower(spins[0]))) == 2
    slopes = back.compile()(spins)
    # sums in another order
    np.testing.assert_allclose(slopes, [forth(x) for x in spins], rtol=1e-10)
    # error h^2 of what is nearly linear, over rounding 1e-15 / 1e-3
    h = 1e-3
    line = (one(7.0 + h) - one(7.0 - h)) / (2.0 * h)
    np.testing.assert_allclose(slopes[1], line, rtol=1e-6)


def programs_in(lowered):
    """Names of the programs in C that a program of XLA's calls."""
    return set(re.findall(r"rollkane_[0-9a-f]+", lowered.as_text()))


def searching():
    """A ground that is found by a search: more than arithmetic."""

    def height(x, y):
        root = jax.lax.while_loop(
            lambda c: jnp.abs(c * c - 1.0 - x * x) > 1e-12,
            lambda c: 0.5 * (c + (1.0 + x * x) / c),
            1.0 + x * x,
        )
        return 0.01 * (root + y * y)

    body = rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1))
    scene = rk.Scene(body, rk.Base(rk.Graph(height)))
    start = rk.place(scene, [1.0, 0.0, 0.0, 0.0], [0.5, 2.0, 1.0], [0.0, 0.0, 0.01])
    return scene, start


def test_rates_that_search_are_tried_once(monkeypatch):
    scene, start = searching()
    run = short(scene, start)
    assert run.method == "diffrax"
    assert "more than arithmetic: while" in run.why
    asked = []
    traced = Prepared.__call__
    note = lambda *a, native: asked.append(native) or traced(*a, native=native)
    monkeypatch.setattr(Prepared, "__call__", note)
    assert short(scene, start).why == run.why
    assert asked == [False]
    with pytest.raises(rk.FieldError, match="more than arithmetic: while"):
        short(scene, start, method="native")


def test_a_program_that_is_too_long_goes_by_diffrax(monkeypatch):
    monkeypatch.setattr("rollkane.codegen.runge_kutta_source._MOST_STATEMENTS", 30)
    monkeypatch.setattr(methods, "_refusals", {})
    jax.clear_caches()  # what was compiled before would serve
    assert "too many operations" in short(*problems.disc()).why


def test_without_a_compiler_there_is_one_sentence(monkeypatch, tmp_path):
    scene, start = problems.disc()
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("CC", "no-such-compiler")
    monkeypatch.setenv("ROLLKANE_CACHE", str(tmp_path / "empty"))
    monkeypatch.setattr(integration, "_warned", set())
    monkeypatch.setattr(methods, "_unusable", {})
    compilers._compiler.cache_clear()
    jax.clear_caches()  # what was compiled before would serve
    no = NoCompilerError("no C compiler was found")

    def missing(*arguments, **options):
        raise no

    monkeypatch.setattr("rollkane.codegen.run_loop.XlaCall", missing)
    with pytest.warns(RuntimeWarning, match="diffrax takes its place") as told:
        run = short(scene, start)
    assert (run.method, run.why) == ("diffrax", str(no))
    assert told[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert short(scene, start).why == run.why
    monkeypatch.undo()
    compilers._compiler.cache_clear()
    assert short(scene, start).method == "native"


def test_a_batch_and_a_system_say_it_too():
    scene, start = problems.disc()
    starts = jax.tree.map(lambda x: jnp.stack([x, x]), start)
    runs = jax.jit(jax.vmap(lambda s: short(scene, s)))(starts)
    assert (runs.method, runs.why) == ("native", "")
    begun = kane.KaneState(jnp.eye(7)[6], jnp.array([0.0, 0.0, 0.0, 0.1, 5.0, 0.0]))
    system = kane.free_rigid_body(1.0, np.diag([1.0, 2.0, 3.0]))
    run = kane.simulate(system, begun, TIMES)
    assert (run.method, run.why) == ("native", "")
    other = kane.simulate(system, begun, TIMES, method="diffrax")
    assert "was chosen" in other.why
    # some tens of roundings of numbers up to five
    np.testing.assert_allclose(run.u, other.u, rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("saveat", dfx.SaveAt(dense=True), "does not keep, got SaveAt.*give the times"),
        ("adjoint", dfx.BacksolveAdjoint(), "got BacksolveAdjoint.*leave it out"),
        ("adjoint", dfx.ImplicitAdjoint(), "got ImplicitAdjoint.*leave it out"),
        ("solver", dfx.KenCarp4(), "several terms.*got KenCarp4.*use Kvaerno5"),
        ("solver", dfx.SemiImplicitEuler(), "several terms.*got SemiImplicitEuler"),
        ("solver", dfx.ItoMilstein(), "several terms"),
    ],
)
def test_what_diffrax_cannot_do_here_is_refused_by_name(name, value, said):
    with pytest.raises(rk.FieldError, match=rf"simulate\.{name}: (?s:.*){said}"):
        short(*problems.disc(), **{name: value})
    if name == "solver":
        with pytest.raises(rk.FieldError, match=r"keeping_energy\.solver: "):
            rk.keeping_energy(BALL, solver=value)
