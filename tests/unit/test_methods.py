"""Which loop takes a run, and what it says of it."""

import warnings

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane import integration, kane, methods
from rollkane.native import NoCompilerError
from rollkane.native import compiler as compilers
from rollkane.scene_files.loading import builtin_scenes, load_scene

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
        ({"solver": dfx.Kvaerno5()}, "Kvaerno5 is none of"),
        ({"solver": dfx.Tsit5(), "adjoint": dfx.DirectAdjoint()}, "adjoint goes by"),
        ({"saveat": dfx.SaveAt(t1=True)}, "saveat goes by"),
        ({"modes": rk.Modes(friction=0.5)}, "modes go by"),
        ({"stepsize_controller": dfx.ConstantStepSize(), "dt0": 0.01}, "stepsize_c"),
    ],
)
def test_what_goes_by_diffrax_says_why(how, why):
    run = short(*problems.disc(), **how)
    assert run.method == "diffrax"
    assert why in run.why


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
    traced = rk.simulation.integrate
    note = lambda *a, native, **k: (
        asked.append(native) or traced(*a, native=native, **k)
    )
    monkeypatch.setattr("rollkane.simulation.integrate", note)
    assert short(scene, start).why == run.why
    assert asked == [False]
    with pytest.raises(rk.FieldError, match="more than arithmetic: while"):
        short(scene, start, method="native")


def test_a_program_that_is_too_long_goes_by_diffrax(monkeypatch):
    monkeypatch.setattr("rollkane.native.step_source._MOST_STATEMENTS", 30)
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

    monkeypatch.setattr("rollkane.native.runs.XlaCall", missing)
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
