"""Random scenes of every law, body, base and motion, checked by their outputs alone."""

import numpy as np
import pytest

import rollkane as rk

from .. import outputs_alone
from ..outputs_alone import (
    BASES,
    BODIES,
    LAWS,
    MOTIONS,
    RESIDUAL,
    Seen,
    examined,
    scene_of,
)


def combinations():
    """Every body on every base, with laws and motions in turn: each with each."""
    found = []
    for i, body in enumerate(BODIES):
        for j, base in enumerate(BASES):
            if body in ("disc", "ring") and base == "hoop":
                continue  # two edges, whose normal no level function has
            law = list(LAWS)[(i + 2 * j) % len(LAWS)]
            motion = list(MOTIONS)[(3 * i + j) % len(MOTIONS)]
            found.append((law, body, base, motion))
    return found


QUICK = {
    ("rubber", "ellipsoid", "plane", "rock"),
    ("rubber", "egg", "bowl", "spin"),
    ("rolling", "disc", "ball", "sway"),
    ("rolling", "ring", "ball", "rest"),
    ("coulomb", "torus", "hills", "rest"),
    ("stribeck", "ball", "funnel", "sway"),
    ("viscous", "implicit", "roller", "spin"),
    ("rolling", "ball", "hoop", "rock"),
}
CASES = sorted(set(combinations()) | QUICK)


@pytest.mark.parametrize(
    "case",
    [c if c in QUICK else pytest.param(c, marks=pytest.mark.slow) for c in CASES],
    ids="-".join,
)
def test_outputs_obey_mechanics(case):
    law, body, base, _ = case
    scene = scene_of(*case)
    for seed in range(1 if case in QUICK else 4):
        start = outputs_alone.start_of(scene, base, 100 * CASES.index(case) + seed)
        found = examined(scene, start, law, body, base)
        assert found.middle >= 4
        # a corner costs 8 of 142 stencils, and there may be two; a blow some more
        assert found.left_out < 0.15 * found.middle
        assert max(found.residuals.values()) < RESIDUAL, found.residuals
        assert found.jump < 1.0
        # what place accepts is nowhere in the base; what gets there is told
        assert found.depth_at_start < 1e-9
        if found.depth > 1e-6:
            times = [0.0, outputs_alone.DURATION]
            run = rk.simulate(scene, start, times, second_contact=True)
            assert run.code == rk.Code.SECOND_CONTACT


def test_every_law_body_base_and_motion_is_there():
    assert len(CASES) >= 60
    for k, names in enumerate((LAWS, BODIES, BASES, MOTIONS)):
        assert {case[k] for case in CASES} == set(names)
    pairs = {(law, motion) for law, _, _, motion in CASES}
    assert len(pairs) == len(LAWS) * len(MOTIONS)


def test_the_check_fails_on_what_is_wrong():
    """A force that is off by 1e-6 of itself, or a contact that jumps, is seen."""
    scene = scene_of("rolling", "ellipsoid", "plane", "rest")
    start = outputs_alone.start_of(scene, "plane", 0)
    step = outputs_alone.LONGEST
    times = np.arange(0.0, 0.1, step)
    out = outputs_alone.outputs(
        rk.simulate(scene, start, times, rtol=3e-13, atol=1e-14)
    )
    shapes = BODIES["ellipsoid"][1], BASES["plane"][1]
    seen = Seen(out, step, *shapes)
    every = np.ones(len(times) - 8, bool)
    assert max(seen.mechanics("rolling", every).values()) < RESIDUAL
    bent = out | {"contact_force": out["contact_force"] * (1.0 + 1e-6)}
    wrong = Seen(bent, step, *shapes).mechanics("rolling", every)
    assert wrong["Newton"] > RESIDUAL
    path = out["contact_on_base"].copy()
    path[12:] += [0.01, 0.0, 0.0]
    jumps = Seen(out | {"contact_on_base": path}, step, *shapes)
    assert jumps.jump() > 1.0


@pytest.mark.parametrize("method", ["native", "diffrax"])
@pytest.mark.parametrize(("seed", "falls"), [(0, 0.31612569555), (3, 0.30675532329)])
def test_a_disc_that_comes_to_lie_on_its_face_ends_there(seed, falls, method):
    """At any tolerance: steps within their own error of it could turn it by any angle.

    Its normal comes to its axis at 1.9 rad/s, to ten relative tolerances before it.
    """
    case = "rolling", "disc", "tyre", "rock"
    scene = scene_of(*case)
    start = outputs_alone.start_of(scene, "tyre", 100 * CASES.index(case) + seed)
    for rtol in (1e-2, 1e-3, 1e-6, 1e-8, 1e-10, 1e-12)[
        :: 1 if method == "native" else 3
    ]:
        run = rk.simulate(scene, start, (0.0, 0.6), rtol=rtol, method=method)
        assert run.code == rk.Code.SURFACE_EDGE, rtol
        # ten tolerances by 1.9 rad/s, and as much by errors of 100 steps
        assert abs(run.final_time - falls) < 10.0 * rtol + 1e-11
