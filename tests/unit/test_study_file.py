"""Studies in files: what is read, and how each mistake is told."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.dynamics.ready_observables import READY
from rollkane.files.scene_files import SceneFileError, builtin_scenes, load_scene
from rollkane.uncertainty.draws import flat
from rollkane.uncertainty.study_file import load_study

from ..quick import slow_but

VARY = """
[vary."start.angular_velocity[2]"]
distribution = "normal"
mean = 3.0
std = 0.5
"""
GOOD = (
    """
title = "Does it turn back?"
scene = "rattleback"
times = [0.0, 0.1]
size = 100
seed = 3
sampling = "sobol"
block = 64
observe = ["spin", "position"]
series = ["energy"]
"""
    + VARY
    + """
[vary."body.mass"]
distribution = "uniform"
low = 0.9
high = 1.1

[[events]]
name = "reversal"
of = "spin"
level = 0.0
direction = -1

[[events]]
of = "lift-off"
stop = true
"""
)


MASS = """
[vary."scene.body.mass"]
distribution = "uniform"
low = 5.0
high = 6.0

"""


def written(folder, text):
    file = folder / "study.toml"
    file.write_text(text)
    return file


def test_what_a_file_says(tmp_path):
    file = load_study(written(tmp_path, GOOD))
    assert file.title == "Does it turn back?"
    assert (file.size, file.seed, file.sampling, file.block) == (100, 3, "sobol", 64)
    study = file.study
    assert study.draws.names == ("start_angular_velocity_2", "body_mass")
    assert list(study.observe) == ["spin", "position"]
    assert list(study.series) == ["energy series"]
    assert study.event_names == ("reversal", "lift-off")
    reversal, lift = study.events
    assert (reversal.direction, reversal.stop, lift.stop) == (-1, False, True)
    np.testing.assert_array_equal(study.times, [0.0, 0.1])


def test_numbers_come_where_they_belong(tmp_path):
    """The start is that of the scene's file, but for what was drawn."""
    study = load_study(written(tmp_path, GOOD)).study
    known = load_scene("rattleback")
    drawn = study.draws.draw(jnp.array([0.8, 0.25]))
    scene, start = study.make(drawn)
    assert scene.body.mass == pytest.approx(0.95, rel=1e-14)  # a quarter of the way
    turning = READY["angular_velocity"](scene, 0.0, start)
    old = READY["angular_velocity"](known.scene, 0.0, known.start)
    wanted = [*old[:2], flat(drawn)["start_angular_velocity_2"]]
    # through a rotation and back: roundings of numbers of order 5
    np.testing.assert_allclose(turning, wanted, atol=1e-13)
    place = READY["position"](scene, 0.0, start)
    np.testing.assert_allclose(
        place, READY["position"](known.scene, 0.0, known.start), atol=1e-13
    )


def test_a_scene_file_beside_the_study(tmp_path):
    (tmp_path / "mine.toml").write_text(BALL)
    text = 'scene = "mine.toml"\nobserve = ["spin"]\n' + VARY
    file = load_study(written(tmp_path, text))
    assert file.title == "a ball of mine"
    assert file.size is None
    assert (file.seed, file.sampling, file.block) == (0, "plain", None)
    np.testing.assert_array_equal(file.study.times, [0.0, 2.0])


def test_numbers_of_modes_vary(tmp_path):
    modes = "[modes]\nfriction = 0.2\nstatic_friction = 0.9\n[run]"
    (tmp_path / "mine.toml").write_text(BALL.replace("[run]", modes))
    text = 'scene = "mine.toml"\nobserve = ["spin"]\n'
    one = VARY.replace("start.angular_velocity[2]", "modes.friction")
    study = load_study(written(tmp_path, text + one)).study
    drawn = study.draws.draw(jnp.array([0.5]))
    assert study.modes is None
    # of a mean of 3, which sticking refuses: NaN, as what a constructor refuses
    assert jnp.isnan(jax.jit(study.make)(drawn)[2].static_friction)
    few = one.replace("mean = 3.0", "mean = 0.3")
    study = load_study(written(tmp_path, text + few)).study
    _, _, modes = study.make(study.draws.draw(jnp.array([0.5])))
    assert modes.friction == pytest.approx(0.3, rel=1e-14)
    assert modes.static_friction == 0.9
    other = written(tmp_path, text + VARY)
    assert load_study(other).study.modes.friction == 0.2
    with pytest.raises(SceneFileError, match=r"did you mean modes.friction\?"):
        load_study(written(tmp_path, text + one.replace("friction", "fiction")))


BALL = """
title = "a ball of mine"
[body]
mass = 1.0
inertia = [[0.004, 0.0, 0.0], [0.0, 0.004, 0.0], [0.0, 0.0, 0.004]]
[body.surface]
kind = "sphere"
radius = 0.1
[start]
rotations = []
angular_velocity = [0.0, 1.0, 0.0]
contact_on_base = [0.0, 0.0, 0.0]
[run]
duration = 2.0
"""

POST = """
[base.surface]
kind = "graph"
f = "0.25 * exp(-((x - 0.4)**2 + y * y) / 0.002)"
[start]"""


def test_a_second_contact_is_looked_for(tmp_path):
    """As the scene's file says: balls that roll at a post, fast or slowly."""
    vary = VARY.replace("[2]", "[1]").replace("3.0", "1.5")
    study = written(tmp_path, f'scene = "mine.toml"\nobserve = ["spin"]\n{vary}\n')
    looking = BALL.replace("[start]", POST) + "second_contact = true\n"
    (tmp_path / "mine.toml").write_text(looking)
    found = rk.monte_carlo(load_study(study).study, 16)
    # 0.2 m for each rad/s in 2 s, to a post whose foot is met 0.27 to 0.29 m on
    reach = 0.2 * found.values("draw.start_angular_velocity_1")
    clear = np.abs(reach - 0.28) > 0.02
    assert 4 < clear.sum() < 16
    ends = np.where(reach > 0.28, rk.Code.SECOND_CONTACT, rk.Code.COMPLETED)
    assert (found.values("code") == ends)[clear].all()
    assert len(set(ends[clear])) == 2


WRONG = {
    "no scene": (("scene = ", "sene = "), ("sene", "did you mean scene?")),
    "another scene": (('"rattleback"', '"ratleback"'), ("scene:", "cannot be used")),
    "a number": (('"rattleback"', "3"), ("scene:", "must name a scene")),
    "an observable": (('"spin", ', '"spinn", '), ("observe[0]", "did you mean spin?")),
    "a list": (('"spin", ', '["spin"], '), ("observe[0]", "is not known")),
    "no list": (('["energy"]', '"energy"'), ("series", "must be a list")),
    "a size": (("size = 100", "size = 0"), ("size", "whole number of at least 1")),
    "a seed": (("seed = 3", "seed = 1.5"), ("seed", "whole number")),
    "sampling": (('"sobol"', '"sobel"'), ("sampling", "plain, latin, sobol")),
    "times": (
        ("times = [0.0, 0.1]", "times = [0.1, 0.1]"),
        ("times: must be finite and strictly increasing",),
    ),
    "title": (('title = "Does it turn back?"', "title = 3"), ("title: must be text",)),
    "level": (
        ("level = 0.0", "level = inf"),
        ("events[0].level: must be finite",),
    ),
    "level of 400 digits": (
        ("level = 0.0", f"level = {10**400}"),
        ("events[0].level: must be finite",),
    ),
    "times of truth": (
        ("times = [0.0, 0.1]", "times = [0, true]"),
        ("times: must be made of real numbers",),
    ),
    "no times": (("times = [0.0, 0.1]", 'times = "ten"'), ("times",)),
    "a path": (('"body.mass"', '"body.mas"'), ("body.mas", "did you mean")),
    "half a tensor": (
        ('"body.mass"', '"body.inertia[0][1]"'),
        ("is one half of a symmetric tensor", 'distribution = "inertia"'),
    ),
    "a row of a tensor": (('"body.mass"', '"body.inertia[0]"'), ("is one half of",)),
    "an index": (("velocity[2]", "velocity[7]"), ("is no number of",)),
    "an empty path": (('"body.mass"', '""'), ("vary",)),
    "a whole": (("velocity[2]", "velocity"), ("draws numbers of shape ()",)),
    "twice": (
        ('[vary."body.mass"]', '[vary."start.angular_velocity"]'),
        ("varies what start.angular_velocity[2] varies, too",),
    ),
    "in another spelling": (
        ('[vary."body.mass"]', MASS + '[vary."body.mass"]'),
        ("body.mass", "varies what scene.body.mass varies, too"),
    ),
    "a distribution": (('"normal"', '"gauss"'), ("is no known kind", "normal")),
    "a list of them": (('"normal"', '["normal"]'), ("is no known kind",)),
    "an argument": (("std = 0.5", "sigma = 0.5"), ("lacks std",)),
    "a range": (("low = 0.9", "low = 1.9"), ("vary",)),
    "an event of nothing": (('of = "spin"', 'of = "sin"'), ("events[0].of",)),
    "an event of a vector": (('of = "spin"', 'of = "position"'), ("is no number to",)),
    "an event of a list": (('of = "spin"', "of = []"), ("events[0]",)),
    "a level": (("level = 0.0", 'level = "low"'), ("level", "must be a number")),
    "a direction": (("direction = -1", "direction = 2"), ("direction",)),
    "a stop": (("stop = true", 'stop = "no"'), ("stop", "must be True or False")),
    "a name": (('name = "reversal"', "name = 3"), ("name", "must be a text")),
    "the name of an observable": (
        ('name = "reversal"', 'name = "spin"'),
        ("events[0].name: is what observe lists, too", "take another name"),
    ),
    "the name of a series": (
        ('name = "reversal"', 'name = "energy series"'),
        ("events[0].name: is what series lists, too",),
    ),
    "an event without a name": (
        ('name = "reversal"\n', ""),
        (
            "events[0]: has no name and takes its observable's, 'spin', which observe "
            "lists, too",
            "give it one of its own",
        ),
    ),
    "a name that is taken": (
        ('name = "reversal"', 'name = "time"'),
        ("events[0].name: is taken", "take another"),
    ),
    "no name": (
        ('name = "reversal"', 'name = "1st"'),
        ("events[0].name: is no name", "a letter first"),
    ),
    "an unknown key": (
        ("level = 0.0", "levle = 0.0"),
        ("levle", "did you mean level?"),
    ),
    "no TOML": (("size = 100", "size = = 100"), ("line",)),
    "nothing to see": (
        (GOOD[GOOD.index("observe") : GOOD.index("\n[vary")], "\n"),
        (),
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_mistakes_are_told(tmp_path, name):
    """With the file's name; ``said`` is in the message, whatever its line breaks."""
    (old, new), said = WRONG[name]
    assert GOOD.count(old) == 1
    file = written(tmp_path, GOOD.replace(old, new))
    if name == "nothing to see":  # but events, which are something
        assert load_study(file).study.observe == {}
        return
    with pytest.raises(SceneFileError) as refused:
        load_study(file)
    text = str(refused.value)
    assert "study.toml" in text
    for part in said:
        assert part in text, text


def test_an_event_of_the_scenes_file_may_be_called_as_an_observable(tmp_path):
    """The study says so of its scene, where it has no event of that name itself."""
    (tmp_path / "mine.toml").write_text(BALL + '[[events]]\nof = "spin"\n')
    text = 'scene = "mine.toml"\nobserve = ["spin"]\n' + VARY
    with pytest.raises(SceneFileError) as refused:
        load_study(written(tmp_path, text))
    (problem,) = refused.value.problems
    assert problem.field == "scene"
    assert "has an event 'spin', and observe lists that name, too" in problem.problem
    assert "in the scene's file" in problem.remedy
    other = text.replace("spin", "tilt")
    assert load_study(written(tmp_path, other)).study.event_names == ("spin",)


def test_all_mistakes_are_told_at_once(tmp_path):
    text = GOOD.replace("size = 100", "size = 0").replace('"uniform"', '"unifrm"')
    with pytest.raises(SceneFileError) as refused:
        load_study(written(tmp_path, text.replace('of = "spin"', 'of = "sin"')))
    assert len(refused.value.problems) == 3
    with pytest.raises(SceneFileError, match="none"):
        load_study(tmp_path / "none.toml")


@pytest.mark.slow
def test_a_study_begins_at_its_own_first_time(tmp_path):
    """On a turntable that speeds up, the start rolls with the base as it then is."""
    text = 'scene = "ellipsoid-on-six-axis-table"\ntimes = [0.3, 0.4]\n'
    study = load_study(written(tmp_path, text + 'observe = ["spin"]\n' + VARY)).study
    scene, start = study.make({"start_angular_velocity_2": jnp.asarray(2.5)})
    t = jnp.asarray(0.3)
    assert READY["spin"](scene, t, start) == pytest.approx(2.5, rel=1e-13)
    assert isinstance(scene, rk.Scene)


TRIAXIAL = """
[body]
mass = 1.0
inertia = [[4e-3, 0.0, 0.0], [0.0, 5e-3, 0.0], [0.0, 0.0, 6e-3]]
surface = { kind = "sphere", radius = 0.1 }
[[loads]]
kind = "gravity"
[run]
duration = 0.2
[start]
orientation = [1.0, 0.0, 0.0, 0.0]
angular_velocity = [0.0, 0.5, 0.3]
"""
RING = (
    TRIAXIAL
    + """
contact_on_base = [0.5, 0.0, 0.0]
base_normal = [0.6, 0.0, 0.8]
[base]
surface = { kind = "ring", radius = 0.5 }
"""
)
SLIDES = (
    TRIAXIAL
    + """
slip = [2.0, 0.0, 0.0]
[base]
surface = { kind = "plane" }
[modes]
friction = 0.2
"""
)
OWN = {"ring.toml": RING, "slides.toml": SLIDES}


@pytest.mark.parametrize("name", slow_but(["slides.toml"], [*OWN, *builtin_scenes()]))
def test_a_study_begins_where_its_scene_does(tmp_path, name):
    """On an edge, which has many normals; with a slip; with bodies in the body."""
    for file, tables in OWN.items():
        (tmp_path / file).write_text(tables)
    scene = load_scene(tmp_path / name if name in OWN else name)
    begin = float(scene.times[0])
    mass = float(scene.scene.body.mass)
    text = f"""
scene = "{name}"
times = [{begin}, {begin + 0.2}]
observe = ["position", "energy"]
[vary."body.mass"]
distribution = "uniform"
low = {mass * (1.0 - 1e-13)!r}
high = {mass * (1.0 + 1e-13)!r}
"""
    study = load_study(written(tmp_path, text)).study
    found = rk.monte_carlo(study, 3, seed=1).mean
    asked = jnp.array([begin, begin + 0.2])
    run = rk.simulate(scene.scene, scene.start, asked, modes=scene.modes)
    # runs at 1e-10 (the scenes' own) and 1e-9 by some hundred steps: 1e-7 of a metre,
    # and a tenth is left for errors that grow, two for energies, by squares of rates
    np.testing.assert_allclose(found["position"], run.position[-1], rtol=0, atol=1e-6)
    np.testing.assert_allclose(found["energy"], run.energy[-1], rtol=1e-5, atol=1e-6)
