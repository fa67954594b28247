"""A motion as a binary glTF file (.glb): meshes and an animation of their poses.

Blender, three.js, engines and viewers of operating systems read it. Lengths are metres
and times are seconds; z, which points up here, is y there: a node above all others
turns it, and everything below it is on the library's fixed axes.

Source: glTF 2.0 Specification, Khronos Group (ISO/IEC 12113:2022).
"""

import json
import os
import struct
import zlib
from typing import Any

import numpy as np

from ..files.atomic_file import write_whole
from ..files.file_endings import MODELS, wrong_ending
from ..simulation.trajectory import Trajectory
from ..validation.checks import FieldError
from .between_samples import at_times
from .film_colors import COLORS, checks
from .mesh import Mesh
from .motion_parts import Part, motion_parts
from .motion_samples import MotionSamples, reached_samples

_FLOAT, _WHOLE = 5126, 5125  # component types: float32, uint32
_VERTICES, _CORNERS = 34962, 34963  # what a buffer view is for
_NEAREST, _REPEAT = 9728, 10497  # how a texture is looked up
_TURN = 0.5  # rad between keys: readers go the shorter way from one to the next
_MOST_KEYS = 20_000
_UPRIGHT = [-float(np.sqrt(0.5)), 0.0, 0.0, float(np.sqrt(0.5))]  # z up to y up, xyzw


def write_glb(
    trajectory: Trajectory, path: str | os.PathLike[str], title: str = ""
) -> None:
    """Write a trajectory as a binary glTF 2.0 file with an animation.

    Every output is a key of the animation; where the body turns by more than half a
    radian between two outputs there are keys between them.

    Args:
        trajectory: One run, not a batch.
        path: Where to, .glb; the folder must exist. The file appears whole or not at
            all.
        title: Name of the scene and of its animation.

    Raises:
        FieldError: a batch, a run of which no state is finite, or another ending.
        OSError: the file cannot be written.
    """
    wrong = wrong_ending(path, MODELS)
    if wrong is not None:
        raise FieldError("path", str(path), *wrong)
    outputs, _ = reached_samples(trajectory)
    keys = at_times(outputs, _key_times(outputs))
    parts = motion_parts(trajectory.scene, keys, outputs).parts
    model = _Model(title or "rollkane", keys.time - keys.time[0])
    for part in parts:
        model.add(part)
    write_whole(path, model.file())


def _key_times(motion: MotionSamples) -> np.ndarray:
    """Times of the outputs, and between them where something turns far."""
    rates = [motion.angular_velocity, motion.base_angular_velocity]
    bodies = range(motion.rolling.shape[1])
    rates += [motion.rolling_column(k, "angular_velocity") for k in bodies]
    speed = np.max([np.linalg.norm(x, axis=1) for x in rates], axis=0)
    angle = np.maximum(speed[1:], speed[:-1]) * np.abs(np.diff(motion.time))
    counts = np.maximum(np.ceil(angle / _TURN), 1.0)
    if counts.sum() > _MOST_KEYS:
        counts = np.maximum(np.floor(counts * _MOST_KEYS / counts.sum()), 1.0)
    row = np.repeat(np.arange(len(counts)), counts.astype(int))
    first = np.cumsum(counts) - counts  # key at which an interval begins
    share = (np.arange(len(row)) - first[row]) / counts[row]
    inner = motion.time[row] + share * np.diff(motion.time)[row]
    return np.concatenate([inner, motion.time[-1:]])


class _Model:
    """A file under way: its tables, and the bytes that they refer to."""

    def __init__(self, title: str, time: np.ndarray):
        self._title, self._bytes = title, bytearray()
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []
        self._nodes: list[dict[str, Any]] = []
        self._meshes: list[dict[str, Any]] = []
        self._materials: list[dict[str, Any]] = []
        self._images: list[dict[str, Any]] = []
        self._samplers: list[dict[str, Any]] = []
        self._channels: list[dict[str, Any]] = []
        self._time = self._accessor(time.astype("<f4"), "SCALAR", bounds=True)

    def add(self, part: Part) -> None:
        """A mesh that moves, as a node."""
        node = len(self._nodes)
        turn = np.roll(part.orientation, -1, axis=1)  # glTF's scalar comes last
        turn = _in_one_sense(turn / np.linalg.norm(turn, axis=1, keepdims=True))
        for path, values in (("translation", part.position), ("rotation", turn)):
            known = {"node": node, "path": path}
            kind = f"VEC{values.shape[1]}"
            sampler = {
                "input": self._time,
                "output": self._accessor(values.astype("<f4"), kind),
                "interpolation": "LINEAR",  # of a rotation: along the great circle
            }
            self._channels.append({"sampler": len(self._samplers), "target": known})
            self._samplers.append(sampler)
        pose = {
            "translation": part.position[0].tolist(),
            "rotation": turn[0].tolist(),
        }
        mesh = self._mesh(part)
        self._nodes.append({"name": part.name, "mesh": mesh} | pose)

    def _mesh(self, part: Part) -> int:
        mesh = part.mesh
        accessors = {
            "POSITION": self._accessor(
                mesh.points.astype("<f4"), "VEC3", _VERTICES, bounds=True
            ),
            "NORMAL": self._accessor(_units(mesh).astype("<f4"), "VEC3", _VERTICES),
            "TEXCOORD_0": self._accessor(mesh.marks.astype("<f4"), "VEC2", _VERTICES),
        }
        corners = mesh.triangles.astype("<u4").reshape(-1)
        primitive = {
            "attributes": accessors,
            "indices": self._accessor(corners, "SCALAR", _CORNERS),
            "material": self._material(part),
        }
        self._meshes.append({"name": part.name, "primitives": [primitive]})
        return len(self._meshes) - 1

    def _material(self, part: Part) -> int:
        """The colours of the viewer's squares, one pixel of a texture for each."""
        picture = checks(part.kind, part.mesh.cells)
        view = self._view(_png(picture.transpose(1, 0, 2)))
        self._images.append({"bufferView": view, "mimeType": "image/png"})
        look: dict[str, Any] = {
            "baseColorTexture": {"index": len(self._images) - 1},
            "metallicFactor": 0.0,
            "roughnessFactor": 0.6,
        }
        material = {"name": part.name, "pbrMetallicRoughness": look}
        if part.seen_through:
            look["baseColorFactor"] = [1.0, 1.0, 1.0, COLORS.veil]
            material["alphaMode"] = "BLEND"
        self._materials.append(material | {"doubleSided": True})
        return len(self._materials) - 1

    def _view(self, data: bytes, target: int | None = None) -> int:
        self._bytes += b"\0" * (-len(self._bytes) % 4)
        view = {"buffer": 0, "byteOffset": len(self._bytes), "byteLength": len(data)}
        self._views.append(view | ({"target": target} if target else {}))
        self._bytes += data
        return len(self._views) - 1

    def _accessor(
        self,
        array: np.ndarray,
        kind: str,
        target: int | None = None,
        *,
        bounds: bool = False,
    ) -> int:
        component = _FLOAT if array.dtype.kind == "f" else _WHOLE
        accessor: dict[str, Any] = {
            "bufferView": self._view(array.tobytes(), target),
            "componentType": component,
            "count": len(array),
            "type": kind,
        }
        if bounds:
            table = array.reshape(len(array), -1)
            accessor["min"] = table.min(axis=0).tolist()
            accessor["max"] = table.max(axis=0).tolist()
        self._accessors.append(accessor)
        return len(self._accessors) - 1

    def file(self) -> bytes:
        """The whole file: a header, the tables as JSON, the numbers."""
        above = {"name": "z up", "rotation": _UPRIGHT}
        children = list(range(len(self._nodes)))
        tables = {
            "asset": {"version": "2.0", "generator": "rollkane"},
            "scene": 0,
            "scenes": [{"name": self._title, "nodes": [len(self._nodes)]}],
            "nodes": [*self._nodes, above | {"children": children}],
            "meshes": self._meshes,
            "materials": self._materials,
            "images": self._images,
            "samplers": [
                {"magFilter": _NEAREST, "minFilter": _NEAREST}
                | {"wrapS": _REPEAT, "wrapT": _REPEAT}
            ],
            "textures": [{"sampler": 0, "source": k} for k in range(len(self._images))],
            "animations": [
                {
                    "name": self._title,
                    "channels": self._channels,
                    "samplers": self._samplers,
                }
            ],
            "accessors": self._accessors,
            "bufferViews": self._views,
            "buffers": [{"byteLength": len(self._bytes)}],
        }
        text = json.dumps(tables, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        numbers = bytes(self._bytes) + b"\0" * (-len(self._bytes) % 4)
        chunks = struct.pack("<II", len(text), 0x4E4F534A) + text
        chunks += struct.pack("<II", len(numbers), 0x004E4942) + numbers
        return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _units(mesh: Mesh) -> np.ndarray:
    """Normals of length one, also where triangles gave none."""
    length = np.linalg.norm(mesh.normals, axis=1, keepdims=True)
    up = np.array([0.0, 0.0, 1.0])
    return np.where(length > 0.5, mesh.normals / np.maximum(length, 0.5), up)


def _in_one_sense(turn: np.ndarray) -> np.ndarray:
    """Quaternions of the sign with which the next one is near."""
    signs = np.sign(np.sum(turn[1:] * turn[:-1], axis=1))
    signs = np.cumprod(np.where(signs == 0, 1.0, signs))
    return turn * np.concatenate([[1.0], signs])[:, None]


def _png(picture: np.ndarray) -> bytes:
    """A small picture as a PNG file; rows from the top, shape (h, w, 3), 0 to 255."""
    height, width = picture.shape[:2]
    rows = picture.astype(np.uint8).reshape(height, -1)
    data = b"".join(b"\0" + row.tobytes() for row in rows)

    def chunk(name: bytes, body: bytes) -> bytes:
        checked = zlib.crc32(name + body)
        return struct.pack(">I", len(body)) + name + body + struct.pack(">I", checked)

    head = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    parts = (
        chunk(b"IHDR", head),
        chunk(b"IDAT", zlib.compress(data)),
        chunk(b"IEND", b""),
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(parts)
