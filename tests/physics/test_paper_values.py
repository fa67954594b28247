"""Every number of the collected equations' section 10, both signs."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics import observables, rolling
from rollkane.paper.euler_lagrange import EQUATIONS
from rollkane.paper.quasi_energy import applied

from .. import paper
from ..quick import slow_but

# 12 printed decimals round at 5e-13; the values are of order 1 to 20 and went through
# some hundred roundings of 1e-16 each
PRINTED = 1e-11
NOW = jnp.zeros(())


def found_values(sign: int) -> dict[str, float]:
    scene, state = paper.scene_and_state(sign)
    contact = rk.contact_of(scene, NOW, state)
    quantities = rk.paper_quantities(contact, principal=True)
    rates = rk.rolling_derivative(scene, NOW, state)
    R, E = contact.rotation, contact.shell.frame
    on_e = lambda fixed: E.T @ (R.T @ fixed)
    values = {name: getattr(quantities, name) for name in "ABCRd"}
    values |= {f"Delta_{i}": getattr(quantities, f"Delta_{i}") for i in (1, 2)}
    for i, j in ((1, 1), (1, 2), (2, 2)):
        values[f"Delta_{i}{j}"] = quantities.Delta[i - 1, j - 1]
    for i, j in ((1, 1), (1, 2), (2, 1), (2, 2)):
        values[f"c{i}{j}"] = quantities.c[i - 1, j - 1]
    vectors = {
        "j": quantities.j,
        "K": on_e(observables.contact_angular_momentum(scene, NOW, state)),
        "m^M ": applied(scene, NOW, state, contact)[0],
        "Rc.e": on_e(rolling.contact_force(scene, NOW, state)),
    }
    for name, vector in vectors.items():
        values |= {f"{name}{k + 1}": vector[k] for k in range(3)}
    names = ("q1'", "q2'", "qc1'", "qc2'", "theta'")
    rates_of = [*rates.contact_on_body, *rates.contact_on_base, rates.angle]
    values |= dict(zip(names, rates_of, strict=True))
    names = ("sigma_1", "tau_1", "n_1")
    values |= dict(zip(names, quantities.w_1, strict=True))
    names = ("sigma'", "tau'", "n'")
    values |= dict(zip(names, rates.angular_velocity, strict=True))
    values["alpha''"] = rates.alpha_dot[0]
    values["T"] = observables.kinetic_energy(scene, NOW, state)
    plain = rk.to_pole_free(scene, state, 0.0)
    w = R @ plain.angular_velocity
    w_dot = R @ rk.rolling_derivative(scene, NOW, plain).angular_velocity
    for axis, a, b in zip("xyz", w, w_dot, strict=True):
        values[f"w, fixed axes {axis}"] = a
        values[f"dw/dt, fixed axes {axis}"] = b
    return {name: float(value) for name, value in values.items()}


@pytest.mark.parametrize("sign", [1, -1])
def test_all_values(sign):
    printed, found = paper.printed_values(), found_values(sign)
    assert set(printed) == set(found)
    for name, (upper, lower) in printed.items():
        exact = upper if sign > 0 else lower
        assert abs(found[name] - exact) < PRINTED, name


@pytest.mark.parametrize("owner", ["S", "Sc"])
def test_chart_data(owner):
    scene, state = paper.scene_and_state(-1)
    if owner == "S":
        surface, q = scene.body.surface, state.contact_on_body
    else:
        surface, q = scene.base.surface, state.contact_on_base
    forms = surface.chart_geometry(q)
    a, b = forms.first_form, forms.second_form
    slopes = jax.jacfwd(lambda q: surface.chart_geometry(q).first_form)(q)
    found = [a[0, 0], a[1, 1], b[0, 0], b[1, 1], slopes[0, 0, 1], slopes[1, 1, 0]]
    np.testing.assert_allclose(found, paper.chart_values()[owner], atol=PRINTED)
    np.testing.assert_allclose([a[0, 1], b[0, 1]], 0.0, atol=1e-14)


@pytest.mark.parametrize("sign", [1, pytest.param(-1, marks=pytest.mark.slow)])
@pytest.mark.parametrize("equations", slow_but(["2.5"], EQUATIONS))
def test_accelerations_by_the_paper(sign, equations):
    scene, state = paper.scene_and_state(sign)
    rates = rk.euler_lagrange_derivative(scene, NOW, state, equations)
    printed = paper.printed_values()
    found = [*rates.angular_velocity, rates.alpha_dot[0]]
    for name, value in zip(("sigma'", "tau'", "n'", "alpha''"), found, strict=True):
        assert abs(float(value) - printed[name][0 if sign > 0 else 1]) < PRINTED


def test_contact_point_and_frame():
    scene, state = paper.scene_and_state(-1)
    shell = rk.contact_of(scene, NOW, state).shell
    np.testing.assert_allclose(
        shell.position, (0.785891598037, 0.446004649941, 0.462011091172), atol=PRINTED
    )
    np.testing.assert_allclose(
        shell.frame,
        [
            [-0.858140118694, -0.312706672984, 0.407197830739],
            [0.473092234626, -0.789721389087, 0.390543038800],
            [0.199447422204, 0.527782781350, 0.825630705271],
        ],
        atol=PRINTED,
    )
