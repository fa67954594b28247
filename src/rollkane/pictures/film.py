"""A motion as a film: GIF or MP4, drawn without a browser.

The same meshes and samples as those of the viewer, from where its page looks at the
motion, in its colours. Needs the extra ``rollkane[film]`` (Pillow; imageio-ffmpeg for
MP4).
"""

import importlib
import io
import os
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..dynamics.scene import Scene
from ..files.atomic_file import write_whole
from ..files.file_endings import ANIMATIONS, VIDEOS, ending, wrong_ending
from ..geometry.numpy_rotations import rotated
from ..simulation.trajectory import Trajectory
from ..validation.checks import FieldError
from .between_samples import at_times
from .film_colors import COLORS, checks
from .motion_parts import Parts, motion_parts, round_length
from .motion_samples import MotionSamples, reached_samples
from .rasterizer import Camera, Picture, draw, empty

_SIZES = {".gif": (400, 300), ".mp4": (640, 480)}  # width and height [px]
_RATES = {".gif": 50.0 / 3.0, ".mp4": 25.0}  # pictures a second; GIF counts 0.01 s
_SHORTEST, _LONGEST = 2.0, 12.0  # of a film [s]: other motions are slowed, or hurried
_FINER = 2  # drawn so many times as fine, against jagged edges
_FIELD = np.tan(np.radians(16.0))  # half of the field of view, upwards
_FAR = 15.0  # sizes of the body: a motion that goes farther is followed
_KEYS = 200  # places of the motion by which the camera is set up
_COLORS = 128  # of a GIF's palette
_SHADE = 0.66  # brightness of what is turned from the sun, of what is level [1]


def write_film(
    trajectory: Trajectory, path: str | os.PathLike[str], title: str = ""
) -> None:
    """Write a trajectory as a film.

    A motion of 2 to 12 s is shown as fast as it is; longer ones faster, shorter ones
    slower, by a factor that the film tells beside the time.

    Args:
        trajectory: One run, not a batch.
        path: Where to, .gif or .mp4; the folder must exist. The file appears whole or
            not at all.
        title: Written above; plain text.

    Raises:
        FieldError: a batch, a run of which no state is finite, or another ending.
        ModuleNotFoundError: Pillow, or of a .mp4 imageio-ffmpeg, is not installed.
        OSError: the file cannot be written.
    """
    wrong = wrong_ending(path, ANIMATIONS + VIDEOS)
    if wrong is not None:
        raise FieldError("path", str(path), *wrong)
    kind = ending(path)
    rate, size = _RATES[kind], _SIZES[kind]
    outputs, _ = reached_samples(trajectory)
    times, speed = film_times(outputs.time, rate)
    pictures = frames(trajectory.scene, outputs, times, size)
    told = (
        _with_text(p, t, speed, title) for p, t in zip(pictures, times, strict=True)
    )
    data = _gif(told, rate) if kind in ANIMATIONS else _mp4(told, rate, size)
    write_whole(path, data)


def film_times(known: np.ndarray, rate: float) -> tuple[np.ndarray, float]:
    """Times of a film's pictures [s], and seconds of the motion in one of the film.

    Args:
        known: Output times [s], shape (T,).
        rate: Pictures a second.
    """
    duration = abs(float(known[-1] - known[0]))
    speed = 1.0
    if duration > _LONGEST:
        below = round_length(duration / _LONGEST)
        bigger = [below, *(round_length(x * below) for x in (2.0, 2.5))]
        speed = next(x for x in bigger if duration / x <= _LONGEST * 1.0001)
    elif 0.0 < duration < _SHORTEST:
        speed = round_length(duration / _SHORTEST)
    count = round(duration / speed * rate) + 1
    first, last = float(known[0]), float(known[-1])
    return np.linspace(first, last, count), speed


def frames(
    scene: Scene, outputs: MotionSamples, times: np.ndarray, size: tuple[int, int]
) -> Iterator[np.ndarray]:
    """Pictures of a motion, one after the other.

    Args:
        scene: Of the motion.
        outputs: What is known of it.
        times: Of the pictures [s].
        size: Width and height of the pictures [px].

    Returns:
        Red, green, blue, 0 to 255, each of shape (height, width, 3).
    """
    motion = at_times(outputs, times)
    seen = motion_parts(scene, motion, outputs)
    view = _View(outputs, seen, (_FINER * size[1], _FINER * size[0]))
    path = _path(outputs, seen.size)
    behind: Picture | None = None
    still = not (outputs.base_moves or view.follows)
    for k, time in enumerate(times):
        camera = view.camera(motion.position[k])
        if behind is None or not still:
            behind = empty(camera, COLORS.sky)
            _draw_all(behind, camera, seen, k, "base")
        picture = behind.copy()
        _draw_all(picture, camera, seen, k, "")
        before = int(np.sum(np.abs(outputs.time - times[0]) <= abs(time - times[0])))
        _draw_path(picture, camera, path[:before], motion, k)
        yield _coarse(picture.color)


def _coarse(color: np.ndarray) -> np.ndarray:
    """Means of the pixels that were drawn finer, 0 to 255."""
    steps = range(_FINER)
    whole = sum(color[i::_FINER, j::_FINER] for i in steps for j in steps)
    return np.rint(np.asarray(whole) / _FINER**2).astype(np.uint8)


def _draw_all(picture: Picture, camera: Camera, seen: Parts, k: int, only: str) -> None:
    """The base, or all else: what is seen through last."""
    chosen = [p for p in seen.parts if (p.kind == "base") == (only == "base")]
    for part in sorted(chosen, key=lambda p: p.seen_through):
        turn, place = part.orientation[k], part.position[k]
        points = place + rotated(turn, part.mesh.points)
        normals = rotated(turn, part.mesh.normals)
        triangles = part.mesh.triangles
        if part.one_sided:
            toward = np.sum(normals * (camera.eye - points), axis=1)
            triangles = triangles[np.any(toward[triangles] > 0.0, axis=1)]
        pattern = checks(part.kind, part.mesh.cells)
        opacity = COLORS.veil if part.seen_through else 1.0
        light = _lit(normals, points, camera)
        places = camera.seen(points)
        draw(picture, places, triangles, part.mesh.marks, pattern, light, opacity)


def _lit(normals: np.ndarray, points: np.ndarray, camera: Camera) -> np.ndarray:
    """Brightness of points, on the side that is seen."""
    toward = np.sum(normals * (camera.eye - points), axis=1)
    facing = np.where(toward < 0.0, -1.0, 1.0)
    x, y = camera.axes[2, :2]  # the sun is above, over the left shoulder of who looks
    sun = np.array([0.5 * x + 0.8 * y, 0.5 * y - 0.8 * x, 1.5])
    sun /= np.linalg.norm(sun)
    return _SHADE + (1.0 - _SHADE) * np.maximum(facing * (normals @ sun) / sun[2], 0.0)


def _path(outputs: MotionSamples, size: float) -> np.ndarray:
    """The contact's path on the base, a little above it, base axes [m]."""
    return outputs.contact_on_base + 0.006 * size * outputs.base_outward


def _draw_path(
    picture: Picture, camera: Camera, path: np.ndarray, motion: MotionSamples, k: int
) -> None:
    """As much of the contact's path as has been rolled, where nothing is before it."""
    if len(path) < 2 or not np.isfinite(path).all():
        return
    fixed = motion.base_origin[k] + rotated(motion.base_orientation[k], path)
    places = camera.seen(fixed)
    steps = np.diff(places, axis=0)
    length = np.max(np.abs(steps[:, :2]), axis=1)
    counts = np.minimum(np.ceil(length), 2000.0) + 1.0  # a dot a pixel
    which = np.repeat(np.arange(len(counts)), counts.astype(int))
    first = np.cumsum(counts) - counts
    share = (np.arange(len(which)) - first[which]) / counts[which]
    dots = places[which] + share[:, None] * steps[which]
    height, width = picture.depth.shape
    wide = np.arange(-1, 2)
    column = np.rint(dots[:, 0, None, None] + wide[:, None]).astype(int)
    row = np.rint(dots[:, 1, None, None] + wide[None, :]).astype(int)
    column, row = np.broadcast_arrays(column, row)
    depth = np.broadcast_to(dots[:, 2, None, None], column.shape)
    held = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    column, row, depth = column[held], row[held], depth[held]
    front = depth <= picture.depth[row, column] * (1.0 + 1e-4)
    picture.color[row[front], column[front]] = COLORS.path


class _View:
    """The camera of the viewer's page: all of the motion in the picture, or followed.

    Attributes:
        follows: Whether the camera goes with the body.
    """

    def __init__(self, outputs: MotionSamples, seen: Parts, shape: tuple[int, int]):
        body = next((p.mesh.points for p in seen.parts if p.kind == "body"), None)
        corners = np.zeros((1, 3)) if body is None else body[:: 1 + len(body) // 200]
        facing = np.nanmean(outputs.outward, axis=0)
        across = float(np.hypot(facing[0], facing[1]))
        bearing = np.arctan2(facing[1], facing[0]) if across > 0.1 else -np.pi / 2
        turn = bearing + 0.45
        lift = float(np.clip(np.arctan2(facing[2], across), 0.15, 0.62))
        c, s, C, S = np.cos(lift), np.sin(lift), np.cos(turn), np.sin(turn)
        eye = np.array([c * C, c * S, s])
        self._axes = np.array([[-S, C, 0.0], [-s * C, -s * S, c], eye])
        rows = np.linspace(0, len(outputs.time) - 1, _KEYS).astype(int)
        turns = outputs.orientation[rows][:, None]
        points = outputs.position[rows][:, None] + rotated(turns, corners[None])
        along = points.reshape(-1, 3) @ self._axes.T
        low, high = along.min(axis=0), along.max(axis=0)
        half = 0.5 * (high - low)
        self.follows = float(np.linalg.norm(half)) > _FAR * seen.size
        if self.follows:
            half = np.minimum(half, 4.0 * seen.size)
        self._middle = self._axes.T @ (0.5 * (low + high))
        self._shape = shape
        height, width = shape
        reach = max(half[1], half[0] * height / width)
        self._distance = float(half[2] + max(reach, 0.5 * seen.size) / (0.76 * _FIELD))

    def camera(self, position: np.ndarray) -> Camera:
        """Where it is when the body's origin is at a place [m]."""
        target = position if self.follows else self._middle
        eye = target + self._distance * self._axes[2]
        focus = 0.5 * self._shape[0] / _FIELD
        return Camera(eye, self._axes, float(focus), self._distance, self._shape)


def _with_text(pixels: np.ndarray, time: float, speed: float, title: str) -> Any:
    """A picture of Pillow's with title, time and speed."""
    from PIL import Image, ImageDraw

    picture = Image.fromarray(pixels, "RGB")
    pen = ImageDraw.Draw(picture)
    hurried = "" if speed == 1.0 else f"   speed {speed:g}"
    size = picture.height // 26
    pen.text((size, size), title, fill="#1c2733", font_size=size)
    below = picture.height - 2 * size
    pen.text((size, below), f"{time:.2f} s{hurried}", fill="#1c2733", font_size=size)
    return picture


def _gif(pictures: Iterator[Any], rate: float) -> bytes:
    """All pictures with one palette, so that nothing flickers."""
    from PIL import Image

    whole = list(pictures)
    some = whole[:: 1 + len(whole) // 6]
    width, height = some[0].size
    sheet = Image.new("RGB", (width, height * len(some)))
    for k, picture in enumerate(some):
        sheet.paste(picture, (0, height * k))
    palette = sheet.quantize(_COLORS)
    plain = [x.quantize(palette=palette, dither=Image.Dither.NONE) for x in whole]
    buffer = io.BytesIO()
    how: dict[str, Any] = {"save_all": True, "append_images": plain[1:], "loop": 0}
    plain[0].save(buffer, "GIF", duration=round(1000 / rate), **how)
    return buffer.getvalue()


def _mp4(pictures: Iterator[Any], rate: float, size: tuple[int, int]) -> bytes:
    """H.264 by ffmpeg, in a form that browsers and slides play."""
    ffmpeg: Any = importlib.import_module("imageio_ffmpeg")
    command = str(ffmpeg.get_ffmpeg_exe())
    with tempfile.TemporaryDirectory(prefix="rollkane-") as folder:
        target = Path(folder) / "film.mp4"
        line = [command, "-loglevel", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]
        line += ["-s", f"{size[0]}x{size[1]}", "-r", str(rate), "-i", "-"]
        line += ["-an", "-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "20"]
        line += ["-movflags", "+faststart", str(target)]
        encoder = subprocess.Popen(
            line, stdin=subprocess.PIPE, stderr=subprocess.PIPE, bufsize=0
        )
        assert encoder.stdin is not None
        try:
            for picture in pictures:
                encoder.stdin.write(picture.tobytes())
        except BrokenPipeError:
            pass  # what it says is told below
        except BaseException:
            encoder.kill()
            encoder.wait()
            raise
        said = encoder.communicate()[1]
        if encoder.returncode:
            raise OSError(f"ffmpeg failed: {said.decode(errors='replace').strip()}")
        return target.read_bytes()
