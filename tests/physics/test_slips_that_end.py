"""Slips that end on a curved base, at any tolerance."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import rollkane as rk

RADIUS, BALL, FRICTION, GRAVITY, SLIP = 0.3, 0.05, 0.3, 9.81, 1.0
END = 0.8  # s
STARTS = (1.0, 0.9)  # share of SLIP
# Steps of a run that ends its slip are some ninety; one that cannot makes them for ever
STEPS = 1000


def _bowl() -> rk.Scene:
    body = rk.Body(0.5, 0.4 * 0.5 * BALL**2 * np.eye(3), rk.Sphere(BALL))
    law = rk.Slipping(rk.CoulombFriction(FRICTION))
    return rk.Scene(body, rk.Base(rk.Sphere(RADIUS, inside=True)), contact=law)


def _start(scene: rk.Scene, slip: float):
    level, still = (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    return rk.place(scene, level, still, (0.0, 0.0, -RADIUS), slip=(slip, 0.0, 0.0))


def _moved(slip: float) -> tuple[float, float]:
    """When the slip ends, and the centre's speed at ``END``: it moves on a circle."""
    length = RADIUS - BALL

    def rates(t, y, slips):  # angle and speed of the centre, slip
        angle, speed, _ = y
        press = GRAVITY * np.cos(angle) + speed**2 / length  # over the mass
        fall = -GRAVITY * np.sin(angle)
        pull = -FRICTION * press if slips else -2.0 / 7.0 * fall  # I = 2/5 m a^2
        return [speed / length, fall + pull, slips * (fall + 3.5 * pull)]

    ends = lambda t, y, slips: y[2]
    ends.terminal = True
    how = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14}
    start = [0.0, slip, slip]
    slid = solve_ivp(rates, (0.0, END), start, events=ends, args=(1.0,), **how)
    rolled = solve_ivp(rates, (slid.t[-1], END), slid.y[:, -1], args=(0.0,), **how)
    return float(slid.t[-1]), float(rolled.y[1, -1])


def _allowed(rtol: float) -> float:
    # a slip is off by rtol of itself a step, of 100 at most, and slows by 7/2 mu g
    return 100 * rtol * SLIP / (3.5 * FRICTION * GRAVITY)


@pytest.mark.parametrize("rtol", [1e-3, 1e-5, 1e-8])
def test_a_slip_ends_while_its_surface_turns(rtol):
    """What steps leave of a slip along the normal does not keep it from ending."""
    scene, modes = _bowl(), rk.Modes(friction=FRICTION)
    start = _start(scene, SLIP)
    run = rk.simulate(scene, start, [0.0, END], modes=modes, rtol=rtol, max_steps=STEPS)
    assert run.code == rk.Code.COMPLETED, run.reason
    assert run.switches.after[: int(run.switches.count)].tolist() == [rk.Mode.ROLLING]
    assert abs(run.switches.time[0] - _moved(SLIP)[0]) < _allowed(rtol)


def test_a_slip_ends_in_a_batch():
    """The same, where plain steps go in lanes."""
    scene, modes = _bowl(), rk.Modes(friction=FRICTION)
    starts = [_start(scene, share * SLIP) for share in STARTS]
    many = jax.tree.map(lambda *x: jnp.stack(x), *starts)
    runs = rk.ensemble(scene, many, [0.0, END], modes=modes, rtol=1e-3, max_steps=STEPS)
    assert (np.asarray(runs.code) == rk.Code.COMPLETED).all()
    assert (np.asarray(runs.mode)[:, -1] == rk.Mode.ROLLING).all()
    speeds = np.linalg.norm(np.asarray(runs.velocity)[:, -1], axis=1)
    for share, found in zip(STARTS, speeds, strict=True):
        wanted = _moved(share * SLIP)[1]
        assert abs(found - abs(wanted)) < GRAVITY * _allowed(1e-3)
