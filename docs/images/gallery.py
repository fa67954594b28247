"""Pages and pictures of the gallery: docs/gallery.md.

``python docs/images/gallery.py pages FOLDER`` runs every scene and writes the page that
plays it, which the site shows; ``python docs/images/gallery.py pictures`` draws the
pictures beside this file from such pages, by a Chromium or Chrome that is installed.
"""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import jax
from PIL import Image

import rollkane as rk
from rollkane.files.scene_files import load_scene

HERE = Path(__file__).parent
OWN = HERE.parent / "gallery"  # scene files of the gallery alone
WINDOW = 960, 640
FRAMES = 600  # of a page, at most
# Pages are drawn without their panels.
BARE = "<style>#panel, #controls { display: none }</style></body>"


class Shown(NamedTuple):
    """How a scene is shown.

    Attributes:
        name: Of a built-in scene, or of a file in docs/gallery.
        share: The picture's time as a share of the run's.
        follow: Whether the picture looks at the body, not at all of its motion.
    """

    name: str
    share: float
    follow: bool = True

    def path(self) -> str | Path:
        """What is loaded."""
        own = OWN / f"{self.name}.toml"
        return own if own.exists() else self.name


SCENES = (
    Shown("rattleback", 0.12),
    Shown("euler-disc", 0.35),
    Shown("rolling-disc", 0.4, follow=False),
    Shown("ball-on-plane", 0.6),
    Shown("ball-on-turntable", 0.45, follow=False),
    Shown("ball-on-tilted-turntable", 0.9),
    Shown("chaplygin-ball", 0.7),
    Shown("routh-sphere", 0.5),
    Shown("ellipsoid-in-bowl", 0.5, follow=False),
    Shown("ellipsoid-on-six-axis-table", 0.5, follow=False),
    Shown("shell-with-pendulum", 0.5),
    Shown("isolator", 0.75),
    Shown("shaken-plate", 0.5, follow=False),
    Shown("ball-in-rolling-shell", 0.4),
    Shown("ball-on-ball-on-turntable", 0.4),
    Shown("ellipsoid-in-rocking-bowl", 0.4),
    Shown("disc-in-hoop", 0.4),
    Shown("egg-in-rocking-cavity", 0.4),
    Shown("shells-in-shells", 0.4),
    Shown("ball-in-pipe", 0.3, follow=False),
    Shown("ball-in-cylinder", 0.4, follow=False),
    Shown("funnel", 0.5),
    Shown("egg", 0.4),
    Shown("bowling-ball", 0.15),
    Shown("hopping-ball", 0.85),
)


def write_page(shown: Shown, folder: Path) -> int:
    """Run a scene and write its page; the number of its frames."""
    file = load_scene(shown.path())
    every = -(-len(file.times) // FRAMES)
    result = rk.simulate(
        file.scene, file.start, file.times[::every], rtol=file.rtol, modes=file.modes
    )
    page = folder / f"{shown.name}.html"
    page.unlink(missing_ok=True)
    result.view(str(page), title=file.title)
    return len(file.times[::every])


def draw(shown: Shown, folder: Path, browser: str) -> None:
    """The picture of a scene."""
    count = write_page(shown, folder)
    page = folder / f"{shown.name}.html"
    page.write_text(page.read_text().replace("</body>", BARE))
    wish = f"frame={int(shown.share * count)}&follow={int(shown.follow)}"
    taken = folder / "taken.png"
    options = ["--headless=new", "--no-sandbox", "--hide-scrollbars"]
    options += ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    options += ["--virtual-time-budget=4000", f"--window-size={WINDOW[0]},{WINDOW[1]}"]
    options += [f"--screenshot={taken}", f"{page.as_uri()}#{wish}"]
    subprocess.run([browser, *options], check=True, capture_output=True)
    picture = Image.open(taken).convert("RGB").resize((480, 320), Image.LANCZOS)
    (HERE / "gallery").mkdir(exist_ok=True)
    picture.save(HERE / "gallery" / f"{shown.name}.png", optimize=True)


def main() -> None:
    """What the command line asks for; names after it choose scenes."""
    jax.config.update("jax_enable_x64", True)
    command, *rest = sys.argv[1:]
    if command == "pages":
        folder = Path(rest[0])
        folder.mkdir(parents=True, exist_ok=True)
        for shown in SCENES:
            write_page(shown, folder)
        return
    found = map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))
    browser = next(filter(None, found))
    with tempfile.TemporaryDirectory() as folder:
        for shown in SCENES:
            if not rest or shown.name in rest:
                draw(shown, Path(folder), browser)


if __name__ == "__main__":
    main()
