"""Frame rate of the live view: how often a second a scene is run for other numbers.

Each frame reads the scene with another mass, runs it, and makes what the page is sent:
the whole motion in 301 frames. On one core; the page's own work in the browser is not
in it. Run by ``make bench-live``.
"""

import argparse
import json
import os
import statistics
import time
from pathlib import Path

WANTED = 60.0  # a second: as often as a screen shows a picture
FRAMES = 30


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, help="Folder of a JSON file to write.")
    parser.add_argument("scenes", nargs="*", help="Built-in scenes; all of them.")
    given = parser.parse_args()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})

    from rollkane.cli.preparation import start_jax
    from rollkane.files.scene_files import builtin_scenes

    start_jax()
    rates = {name: rate(name) for name in given.scenes or builtin_scenes()}
    width = max(map(len, rates))
    for name, found in rates.items():
        verdict = "" if found >= WANTED else f"  below {WANTED:g}"
        print(f"{name:<{width}}  {found:6.0f} frames a second{verdict}")
    if given.out:
        text = json.dumps({"frames_per_second": rates, "wanted": WANTED}, indent=1)
        (given.out / "live.json").write_text(text + "\n")


def rate(name: str) -> float:
    """Frames a second: the median of their times on this processor."""
    from rollkane.pictures.live_run import LiveRun

    live = LiveRun(name)
    (mass,) = [one for one in live.numbers if one.path == "body.mass"]
    seconds = []
    for k in range(FRAMES + 2):
        values = {mass.path: mass.value * (1.0 + 0.01 * k)}
        began = time.process_time()
        json.dumps(live.data(values, shapes=False))
        seconds.append(time.process_time() - began)
    return 1.0 / statistics.median(seconds[2:])  # the first two compile


if __name__ == "__main__":
    main()
