"""The command line: what it prints, what it writes, and how it refuses."""

import importlib.util
import json
import math
import os
import shlex
import subprocess
import sys

import click.testing
import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import rollkane as rk
from rollkane.cli import main
from rollkane.cli.output_files import write
from rollkane.cli.preparation import start_jax
from rollkane.codegen import NoCompilerError
from rollkane.files.scene_files import load_scene
from rollkane.simulation import run as simulation

BALL = """\
title = "a ball on a ball"
[body]
mass = 1.0
inertia = [[0.004, 0, 0], [0, 0.004, 0], [0, 0, 0.004]]
surface = { kind = "sphere", radius = 0.1 }
[base.surface]
kind = "sphere"
radius = 0.5
[start]
rotations = []
angular_velocity = [0.0, 5.0, 2.0]
contact_on_base = [0.0, 0.0, 0.5]
[run]
duration = 1.0
outputs = 21
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "ball.toml").write_text(BALL)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def rollkane_with(*arguments):
    # the command sets XLA_FLAGS for its own process; the runner takes that back
    kept = {"XLA_FLAGS": os.environ.get("XLA_FLAGS")}
    return click.testing.CliRunner(env=kept).invoke(main, arguments)


def in_a_process(code):
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_help_waits_for_nothing_heavy():
    out = in_a_process(
        "import sys\n"
        "from rollkane.cli import main\n"
        "main(['--help'], standalone_mode=False)\n"
        "heavy = {'jax', 'numpy', 'pydantic', 'matplotlib', 'xarray', 'diffrax'}\n"
        "print(sorted(heavy & set(sys.modules)))\n"
    )
    assert "simulate" in out
    assert out.rstrip().endswith("[]")


@pytest.mark.parametrize("command", ["steady", "family", "fit", "monte-carlo", "sweep"])
def test_examples_of_help_can_be_copied(command):
    """A line of the shell, with its continuation, and no marks of the docstring."""
    text = rollkane_with(command, "--help").output
    assert "\\b" not in text
    assert "\b" not in text
    (at,) = (i for i in [text.find(f"\n  rollkane {command} ")] if i >= 0)
    example = text[at:].lstrip().split("\n\n")[0]
    words = shlex.split(example.replace("\\\n", " "))
    assert "\\" not in "".join(words)
    assert "\n" not in example.replace("\\\n", " ")  # or the shell ends it there
    options = {name for x in main.commands[command].params for name in x.opts}
    assert {word for word in words if word.startswith("--")} <= options


def test_scenes_and_schema_do_not_wait_for_jax():
    out = in_a_process(
        "import sys\n"
        "from rollkane.cli import main\n"
        "main(['scenes'], standalone_mode=False)\n"
        "main(['schema'], standalone_mode=False)\n"
        "print('jax' in sys.modules)\n"
    )
    assert out.rstrip().endswith("False")


OURS = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold="


def test_jax_is_set_up_before_it_starts():
    out = in_a_process(
        "import os, sys\n"
        "os.environ['XLA_FLAGS'] = '--xla_cpu_enable_fast_math=false'\n"
        "from rollkane.cli.preparation import start_jax\n"
        "assert 'jax' not in sys.modules\n"
        "start_jax()\n"
        "import jax\n"
        "print(jax.numpy.ones(1).dtype, os.environ['XLA_FLAGS'])\n"
    )
    assert out == f"float64 --xla_cpu_enable_fast_math=false {OURS}65536\n"


def test_flags_of_the_user_stay(monkeypatch):
    monkeypatch.setenv("XLA_FLAGS", OURS + "2048")
    start_jax()
    assert os.environ["XLA_FLAGS"] == OURS + "2048"


def test_the_module_runs_as_the_command():
    command = [sys.executable, "-m", "rollkane", "--version"]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert done.stdout == rollkane_with("--version").output


def test_version():
    result = rollkane_with("--version")
    assert result.output == f"rollkane, version {rk.__version__}\n"


def test_scenes():
    result = rollkane_with("scenes")
    assert result.exit_code == 0
    names = [line.split()[0] for line in result.output.splitlines()]
    assert "rattleback" in names
    assert all(len(line.split()) > 5 for line in result.output.splitlines())


def test_schema():
    schema = json.loads(rollkane_with("schema").output)
    assert schema["title"] == "SceneTable"
    assert {"body", "start", "run"} == set(schema["required"])


def test_check(folder):
    result = rollkane_with("check", "ball.toml")
    assert result.exit_code == 0
    assert "ball.toml: good (a ball on a ball; 21 outputs over 1 s)" in result.output


def test_simulate_writes_everything(folder, monkeypatch):
    import xarray

    # on a machine however slow, the second run is made that tells compiling apart
    monkeypatch.setattr("rollkane.cli.simulate_command._SHORT", math.inf)

    targets = {
        "--out": "run.nc",
        "--plot": "run.png",
        "--path": "path.png",
        "--view": "run.html",
    }
    options = [word for pair in targets.items() for word in pair]
    result = rollkane_with("simulate", "ball.toml", *options)
    assert result.exit_code == 0, result.output
    text = " ".join(result.output.split())
    for part in (
        "a ball on a ball",
        "spin +2 -> +2 rad/s",
        "reversals none",
        "energy drift",
        "accepted,",
        "would have to pull first at t = 0.6",
        "friction needed",
        "s to trace and compile,",
        *(f"wrote {name}" for name in targets.values()),
    ):
        assert part in text
    assert set(os.listdir(folder)) == {"ball.toml", *targets.values()}
    for name in ("run.png", "path.png"):
        assert (folder / name).read_bytes().startswith(b"\x89PNG")
    with xarray.open_dataset(folder / "run.nc", engine="h5netcdf") as run:
        np.testing.assert_array_equal(run["time"], np.linspace(0, 1, 21))
        np.testing.assert_allclose(run["energy"], run["energy"][0], rtol=1e-8)
        assert run.attrs["reason"] == "completed"


def test_options_replace_the_file(folder):
    import xarray

    options = ["--duration", "0.5", "--outputs", "6", "--rtol", "1e-7"]
    result = rollkane_with(
        "simulate", "ball.toml", "-q", "--atol", "1e-8", "--out", "a.nc", *options
    )
    assert (result.exit_code, result.output) == (0, "")
    with xarray.open_dataset(folder / "a.nc", engine="h5netcdf") as run:
        np.testing.assert_array_equal(run["time"], np.linspace(0, 0.5, 6))


def test_bad_scene_writes_nothing(folder):
    bad = BALL.replace("mass = 1.0", "mass = -1.0").replace("duration", "durration")
    (folder / "bad.toml").write_text(bad)
    for command in (["check"], ["simulate", "--out", "a.nc", "--plot", "a.png"]):
        result = rollkane_with(*command, "bad.toml")
        assert result.exit_code == 2
        assert (
            "bad.toml:3:8: error: body.mass: must be positive, got -1.0 — give the "
            "mass in kg\n    mass = -1.0\n           ^\n" in result.output
        )
        assert "error: run.durration: is an unknown name — did you" in result.output
        assert "3 errors in bad.toml" in result.output  # and duration is missing
    assert set(os.listdir(folder)) == {"ball.toml", "bad.toml"}


def test_unknown_scene():
    result = rollkane_with("simulate", "ratleback")
    assert result.exit_code == 2
    assert "did you mean rattleback?" in result.output


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--out", "none/run.nc"], "none does not exist; make it first"),
        (["--plot", "."], "is a folder; give the name of a file"),
        (["--out", "ball.toml"], "is the file of SCENE; give another name"),
        (["--plot", "a.png", "--path", "./a.png"], "is the file of --plot"),
        (["--rtol", "nan"], "nan is not a positive number"),
        (["--rtol", "1e-20"], "is below what float64 can hold"),
        (["--atol", "-1"], "-1 is not a positive number"),
        (["--duration", "zero"], "'zero' is not a number"),
        (["--outputs", "1"], "1 is not in the range 2<=x<=10000000"),
        (["--max-steps", "0"], "0 is not in the range x>=1"),
        (["--rtoll", "1"], "--rtol"),
    ],
)
def test_bad_options(folder, monkeypatch, arguments, message):
    def never(*_, **__):
        raise AssertionError("ran in spite of bad options")

    if "1e-20" not in arguments:  # which only the run itself can judge
        monkeypatch.setattr(simulation, "simulate", never)
    result = rollkane_with("simulate", "ball.toml", *arguments)
    assert result.exit_code == 2
    assert message in result.output.replace("\n", " ")
    assert os.listdir(folder) == ["ball.toml"]


@pytest.mark.parametrize(
    ("option", "name", "module", "extra"),
    [
        ("--out", "a.nc", "h5py", "results"),
        ("--plot", "a.svg", "matplotlib", "plot"),
    ],
)
def test_missing_extra_is_named(folder, monkeypatch, option, name, module, extra):
    find = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == module else find(name)
    )
    result = rollkane_with("simulate", "ball.toml", option, name)
    assert result.exit_code == 2
    assert f"needs {module}, which is not installed" in result.output
    assert f"pip install 'rollkane[{extra}]'" in result.output.replace("\n", " ")


def test_a_run_that_stops_early_writes_what_it_reached(folder):
    import xarray

    result = rollkane_with(
        "simulate", "ball.toml", "--max-steps", "10", "--out", "part.nc"
    )
    assert result.exit_code == 3
    assert "error: stopped at t = 0." in result.output
    assert "s of 1 s: the largest number of steps was reached" in result.output
    with xarray.open_dataset(folder / "part.nc", engine="h5netcdf") as run:
        assert run.attrs["code"] == 1
        reached = np.isfinite(run["energy"].values)
        assert 1 < reached.sum() < 21
        assert reached[: reached.sum()].all()


def test_a_start_that_cannot_move(folder):
    (folder / "fast.toml").write_text(BALL.replace("5.0, 2.0", "1e200, 2.0"))
    result = rollkane_with(
        "simulate", "fast.toml", "--out", "none.nc", "--view", "none.html"
    )
    assert result.exit_code == 3
    assert "stopped at t = 0 s of 1 s: the start cannot be used" in result.output
    # files hold the start, whose energy and force are beyond the largest number
    for told in ("energy            is no", "normal force      is no"):
        assert told in result.output
    assert set(os.listdir(folder)) == {"ball.toml", "fast.toml", "none.nc", "none.html"}


def test_a_run_without_any_state_shows_nothing(folder, capsys):
    file = load_scene("ball.toml")
    mass = lambda scene: scene.body.mass
    scene = eqx.tree_at(mass, file.scene, jnp.asarray(np.nan))
    run = rk.simulate(scene, file.start, file.times)
    assert run.code == rk.Code.BAD_SCENE
    assert not write("view", run, folder / "none.html", "")
    assert "did not write" in capsys.readouterr().err
    assert not (folder / "none.html").exists()


def test_a_file_that_is_not_written_has_its_exit_code(folder, monkeypatch):
    """It was 0, which says that all are written."""

    def nothing(*_):
        raise rk.FieldError("Motion.time", [], "has no state to show", "run longer")

    monkeypatch.setattr("rollkane.cli.output_files._writer", lambda *_: nothing)
    done = rollkane_with("simulate", "ball.toml", "--out", "a.nc", "-q")
    assert "did not write a.nc: Motion.time: has no state" in done.output
    assert done.exit_code == 1
    assert os.listdir(folder) == ["ball.toml"]


def test_a_disk_that_refuses(folder, monkeypatch):
    def full(*_):
        raise OSError("no space left on device")

    monkeypatch.setattr("rollkane.files.export.write_whole", full)
    result = rollkane_with("simulate", "ball.toml", "-q", "--out", "a.nc")
    assert result.exit_code == 1
    assert "cannot write a.nc: no space left" in result.output
    assert os.listdir(folder) == ["ball.toml"]


def test_work_precision(folder):
    """A table, a recommendation, and the files that were asked for."""
    options = ["--horizon", "0.5", "--solver", "Dopri5", "--method", "native"]
    options += ["--rtol", "1e-6", "--rtol", "1e-9", "--repeats", "1"]
    options += ["--json", "work.json", "--plot", "work.png", "--quiet"]
    done = rollkane_with("work-precision", "ball.toml", *options)
    assert done.exit_code == 0, done.output
    assert done.output.startswith("a ball on a ball: 0.5 s\nsolver")
    assert "for 1e-06: Dopri5, native" in done.output
    rows = json.loads((folder / "work.json").read_text())["rows"]
    assert [row["setting"]["rtol"] for row in rows] == [1e-6, 1e-9]
    assert (folder / "work.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize(
    ("target", "old"), [("--json", "old.json"), ("--plot", "old.png")]
)
def test_work_precision_on_a_disk_that_refuses(folder, monkeypatch, target, old):
    """A sentence, and no half of a file in the place of the old one."""

    def full(*_):
        raise OSError("no space left on device")

    (folder / old).write_text("as it was")
    options = ["--horizon", "0.5", "--solver", "Dopri5", "--method", "native"]
    options += ["--rtol", "1e-6", "--repeats", "1", "--quiet", "--force"]
    # the loop in C needs a disk of its own, so it is made before
    assert rollkane_with("work-precision", "ball.toml", *options).exit_code == 0
    monkeypatch.setattr("rollkane.files.atomic_file.os.fsync", full)
    done = rollkane_with("work-precision", "ball.toml", *options, target, old)
    assert done.exit_code == 1
    assert "cannot write: no space left" in done.output
    assert (folder / old).read_text() == "as it was"
    assert set(os.listdir(folder)) == {"ball.toml", old}


def test_work_precision_without_a_setting_that_worked(folder):
    """A sentence, not a traceback or a recommendation of nothing."""
    options = ["--horizon", "0.5", "--solver", "Dopri5", "--method", "native"]
    options += ["--rtol", "1e-20", "--json", "work.json", "--plot", "work.png"]
    done = rollkane_with("work-precision", "ball.toml", *options, "--quiet")
    assert done.exit_code == 1
    assert "no setting worked (Dopri5, native: tolerances below" in done.output
    assert json.loads((folder / "work.json").read_text())["rows"] == []
    assert not (folder / "work.png").exists()


def test_work_precision_without_a_compiler(folder, monkeypatch):
    """Nothing is called native that was run by diffrax."""

    def broken():
        raise NoCompilerError("no C compiler was found")

    monkeypatch.setattr("rollkane.studies.timing.check_usable", broken)
    options = ["--horizon", "0.2", "--solver", "Tsit5", "--rtol", "1e-4", "-q"]
    done = rollkane_with("work-precision", "ball.toml", *options, "--repeats", "1")
    assert done.exit_code == 0, done.output
    assert "skipped: Tsit5, native: no C compiler was found" in done.output
    assert "for 1e-06" in done.output
    assert done.output.count("Tsit5, native") == 1
    with pytest.raises(rk.FieldError, match="no C compiler was found"):
        rk.recommend(load_scene("ball.toml"), method="native")


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--solver", "Euler8"], "is no solver of diffrax"),
        (["--json", "nowhere/work.json"], "does not exist; make it first"),
    ],
)
def test_work_precision_refuses(folder, options, says):
    done = rollkane_with("work-precision", "ball.toml", "--quiet", *options)
    assert done.exit_code == 2
    assert says in done.output
