"""Waiting: what is told of a long run, Ctrl-C, exit codes, completion."""

import csv
import json
import math
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import rollkane as rk
from rollkane.cli import waiting
from rollkane.codegen.run_watch import _WATCH, watched_run
from tests.unit.test_cli import BALL, rollkane_with

PAGE = Path(__file__).parents[2] / "docs" / "command-line.md"

# presses Ctrl-C when the loop in C has come to half a second of the motion
PRESSES = """
import os, signal, sys, threading, time
from rollkane.cli import main
from rollkane.codegen.run_watch import _WATCH

def press():
    while not _WATCH.time > 0.5:
        time.sleep(0.01)
    os.kill(os.getpid(), signal.SIGINT)

threading.Thread(target=press, daemon=True).start()
main()
"""


def in_a_process(code, *arguments):
    done = [sys.executable, "-c", code, *arguments]
    return subprocess.run(done, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_ctrl_c_keeps_what_was_reached(tmp_path):
    (tmp_path / "ball.toml").write_text(BALL)
    out = tmp_path / "part.csv"
    # it would take a billion steps
    options = ["--duration", "1e8", "--outputs", "2000001", "--max-steps", "1000000000"]
    files = [str(tmp_path / "ball.toml"), "--out", str(out)]
    done = in_a_process(PRESSES, "simulate", *files, *options, "--json")
    assert done.returncode == 130, done.stderr
    told = json.loads(done.stdout)
    assert told["code"] == rk.Code.INTERRUPTED
    assert 0.5 < told["final_time"] < 1e8
    assert "s of 1e+08 s: interrupted: what was reached until then" in done.stderr
    with out.open() as table:
        first = next(csv.DictReader(table))
    assert float(first["position_z"]) == pytest.approx(0.6, abs=1e-12)  # radii's sum


class _Terminal:
    """Standard error, as a terminal."""

    def __init__(self):
        self.text = ""

    def isatty(self):
        return True

    def write(self, text):
        self.text += text

    def flush(self):
        pass


def told_of(monkeypatch, seconds, quiet=False):
    """What a wait of so many seconds writes, with a second that passes in 0.05 s."""
    begun = time.monotonic()
    clock = lambda: begun + 20 * (time.perf_counter() - origin)
    origin = time.perf_counter()
    screen = _Terminal()
    monkeypatch.setattr(waiting, "_BETWEEN", 0.005)
    monkeypatch.setattr(waiting.time, "monotonic", clock)
    monkeypatch.setattr(sys, "stderr", screen)
    shares = iter([math.nan] * 15 + [k / 1000 for k in range(1, 900)])
    work = lambda watch: time.sleep(seconds / 20)
    found = waiting.waited(work, lambda watch: next(shares), quiet)
    monkeypatch.undo()
    assert not found.interrupted
    return screen.text


def test_a_long_run_tells_its_share_and_the_time_left(monkeypatch):
    said = told_of(monkeypatch, 8.0)
    assert "compiling or running for" in said
    assert re.search(r"\d+ %, \d+ s left", said)
    assert said.endswith("\r")  # the line is taken away


def test_nothing_is_told_of_a_short_run_nor_quietly(monkeypatch):
    assert told_of(monkeypatch, 0.2) == ""
    assert told_of(monkeypatch, 4.0, quiet=True) == ""


def test_nothing_is_told_where_nobody_looks(tmp_path):
    (tmp_path / "ball.toml").write_text(BALL)
    done = rollkane_with("simulate", str(tmp_path / "ball.toml"), "-v")
    assert done.exit_code == 0
    assert "left" not in done.output
    assert re.search(r"loop +native", done.output)


def test_a_failure_is_raised_where_it_can_be_answered():
    def fail(watch):
        raise ValueError("this")

    with pytest.raises(ValueError, match="this"):
        waiting.waited(fail, lambda watch: math.nan, quiet=True)


def test_the_watch_is_clean_behind_a_run():
    with watched_run() as watch:
        assert (watch.looks, watch.ends) == (1, 0)
        watch.ends = 1
    assert (_WATCH.looks, _WATCH.ends) == (0, 0)


def test_runs_end_at_once_where_they_are_told():
    """Alone, in modes and in lanes; and not any more afterwards."""
    scene = rk.Scene(rk.Body(1.0, 0.004 * np.eye(3), rk.Sphere(0.1)))
    start = rk.place(scene, (1.0, 0.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 0.0))
    times = [0.0, 1.0]
    modes = rk.Modes(friction=1.0)
    calls = {
        "alone": lambda: rk.simulate(scene, start, times).code,
        "modes": lambda: rk.simulate(scene, start, times, modes=modes).code,
        "lanes": lambda: rk.ensemble(scene, [start, start], times).code[0],
    }
    for call in calls.values():
        with watched_run() as watch:
            watch.ends = 1
            assert int(call()) == rk.Code.MAX_STEPS
        assert int(call()) == rk.Code.COMPLETED


def codes_of_the_page():
    section = PAGE.read_text().split("## Exit codes")[1].split("##")[0]
    return {int(code) for code in re.findall(r"^\| (\d+) \|", section, re.MULTILINE)}


def test_the_page_lists_the_exit_codes_that_there_are(tmp_path, monkeypatch):
    """Each code of the table is one that a command gives; 130 is tested above."""
    scene = tmp_path / "ball.toml"
    scene.write_text(BALL)

    def full(*_):
        raise OSError("no space left on device")

    found = {rollkane_with("check", str(scene)).exit_code}
    found |= {rollkane_with("check", str(tmp_path / "none.toml")).exit_code}
    short = ("simulate", str(scene), "-q", "--max-steps", "5")
    found |= {rollkane_with(*short).exit_code}
    with monkeypatch.context() as broken:
        broken.setattr("rollkane.files.csv_table.write_whole", full)
        out = str(tmp_path / "a.csv")
        found |= {rollkane_with("simulate", str(scene), "-q", "--out", out).exit_code}
    assert found | {waiting.INTERRUPTED} == codes_of_the_page()
    assert rollkane_with("simulate", "no-such-scene").exit_code == 2


def test_ctrl_c_before_anything_runs_has_the_same_code(monkeypatch):
    def interrupted():
        raise KeyboardInterrupt

    monkeypatch.setattr("rollkane.files.scene_files.builtin_scenes", interrupted)
    done = rollkane_with("scenes")
    assert (done.exit_code, done.output) == (130, "stopped: nothing was written\n")


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        ("rollkane sim", "simulate"),
        ("rollkane simulate rattle", "rattleback"),
        ("rollkane simulate rattleback --ver", "--verbose"),
        ("rollkane sweep rattleback --observe fric", "friction_ratio"),
    ],
)
def test_shells_complete_words(words, wanted):
    """As bash asks: the words in the environment, an answer a line."""
    asked = {"_ROLLKANE_COMPLETE": "bash_complete", "COMP_WORDS": words}
    asked |= {"COMP_CWORD": str(len(words.split()) - 1)}
    code = "from rollkane.cli import main; main(prog_name='rollkane')"
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | asked,
        capture_output=True,
        text=True,
        check=False,
    )
    assert f"plain,{wanted}" in done.stdout.splitlines(), done.stderr


def test_json_is_one_document(tmp_path):
    scene = tmp_path / "ball.toml"
    scene.write_text(BALL)
    told = json.loads(rollkane_with("simulate", str(scene), "--json").output)
    assert (told["code"], told["final_time"], told["wrote"]) == (0, 1.0, [])
    assert told["first"]["position"] == pytest.approx([0, 0, 0.6])
    # free rolling without spin of its own: its energy is kept to the run's tolerance
    assert told["last"]["energy"] == pytest.approx(told["first"]["energy"], rel=1e-8)
    assert json.loads(rollkane_with("check", str(scene), "--json").output)["good"]
    scene.write_text(BALL.replace("mass = 1.0", "mass = -1.0"))
    refused = rollkane_with("check", str(scene), "--json")
    assert refused.exit_code == 2
    (problem,) = json.loads(refused.output)["problems"]
    assert (problem["field"], problem["line"]) == ("body.mass", 3)
    assert "rattleback" in json.loads(rollkane_with("scenes", "--json").output)
    steady = rollkane_with("steady", "rolling-disc", "--hold", "tilt", "--json", "-")
    assert "generator" in json.loads(steady.output)
