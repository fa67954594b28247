"""Make rattleback.png: Kane and Levinson's stone reverses twice.

With rollkane and its plot extra installed:

    python docs/images/make_rattleback.py
"""

from pathlib import Path

import jax
import numpy as np
from matplotlib.collections import PolyCollection

import rollkane as rk
from rollkane.files.atomic_file import write_whole
from rollkane.pictures.mesh import surface_mesh
from rollkane.pictures.motion_samples import motion_samples
from rollkane.pictures.plot_path import draw_path
from rollkane.pictures.plot_style import BLUE, FAINT, INK, RED, dress, new_figure, png

SHOWN = (0.0, 1.35, 2.7, 4.0, 5.7)  # times at which the stone is drawn [s]
LIGHT, DARK = np.array([0.957, 0.937, 0.902]), np.array([0.851, 0.471, 0.235])


def stone_in_motion():
    """Twenty seconds of the stone of Kane and Levinson (1982), without losses."""
    stone = rk.Body(
        mass=1.0,
        center_of_mass=(0.0, 0.0, 0.01),
        inertia=[[2e-4, -2e-5, 0.0], [-2e-5, 1.6e-3, 0.0], [0.0, 0.0, 1.7e-3]],
        surface=rk.Ellipsoid((0.2, 0.03, 0.02)),
    )
    scene = rk.Scene(stone)
    half = np.radians(0.25)  # tilted by 0.5 degrees about x, then about y, upside down
    tilt = np.array([np.cos(half), np.sin(half)])
    start = rk.place(
        scene,
        orientation=(
            -tilt[1] * tilt[0],
            tilt[0] * tilt[0],
            -tilt[1] * tilt[1],
            tilt[0] * tilt[1],
        ),
        angular_velocity=(-0.04363267749186967, -0.04363101609320878, 4.99961923789),
        contact_on_base=(0.0, 0.0, 0.0),
    )
    return rk.simulate(scene, start, np.linspace(0.0, 20.0, 8001), rtol=1e-10)


def draw_stone(panel, mesh, quaternion, height, eye):
    """The stone in a position, with squares on it, seen from a direction."""
    a, b, c, d = quaternion
    rotation = np.array(
        [
            [1 - 2 * (c * c + d * d), 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), 1 - 2 * (b * b + d * d), 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), 1 - 2 * (b * b + c * c)],
        ]
    )
    right = np.cross([0.0, 0.0, 1.0], eye)
    right /= np.linalg.norm(right)
    sight = np.stack([right, np.cross(eye, right)])
    corners = mesh.triangles
    normals = mesh.normals[corners].mean(axis=1) @ rotation.T
    seen = normals @ eye > -0.02
    world = mesh.points @ rotation.T + [0.0, 0.0, height]
    shadow = (world * [1.0, 1.0, 0.0]) @ sight.T
    panel.add_collection(
        PolyCollection(shadow[corners], facecolors="#dfe4ea", edgecolors="#dfe4ea")
    )
    square = np.floor(mesh.marks[corners].mean(axis=1) * [12, 6]).sum(axis=1) % 2
    base = np.where(square[:, None] > 0, DARK, LIGHT)
    sun = sight[0] * -0.4 + sight[1] * 0.5 + eye * 0.75
    shade = 0.55 + 0.5 * np.clip(normals @ sun, 0.0, None)
    color = np.clip(base * shade[:, None], 0.0, 1.0)
    places = world @ sight.T
    order = np.argsort(world[corners].mean(axis=1) @ eye)
    order = order[seen[order]]
    panel.add_collection(
        PolyCollection(
            places[corners][order],
            facecolors=color[order],
            edgecolors=color[order],
            linewidths=0.4,
        )
    )
    panel.set_xlim(-0.21, 0.21)
    panel.set_ylim(-0.13, 0.15)
    panel.set_aspect("equal")
    panel.set_axis_off()


def main():
    """Write rattleback.png beside this file."""
    jax.config.update("jax_enable_x64", True)
    motion = motion_samples(stone_in_motion())
    mesh = surface_mesh(
        rk.Ellipsoid((0.2, 0.03, 0.02)),
        motion.contact_on_body,
        motion.body_outward,
        0.2,
        (241, 121),
    )
    figure = new_figure((11.0, 6.0))
    rows = figure.subfigures(2, 1, height_ratios=(1.0, 2.2))
    eye = np.array([0.25, -0.75, 0.61])
    eye /= np.linalg.norm(eye)
    for panel, time in zip(rows[0].subplots(1, len(SHOWN)), SHOWN, strict=True):
        k = int(np.argmin(np.abs(motion.time - time)))
        height = motion.position[k, 2]
        draw_stone(panel, mesh, motion.orientation[k], height, eye)
        panel.set_title(
            f"{time:g} s,  {motion.spin[k]:+.1f} rad/s".replace("-", "−"),
            fontsize=10,
            color=INK,
        )
    left, right = rows[1].subplots(1, 2, width_ratios=(1.35, 1.0))
    left.axhline(0.0, color=FAINT, lw=1.0)
    left.plot(motion.time, motion.spin, color=BLUE, lw=1.1)
    shown = np.interp(SHOWN, motion.time, motion.spin)
    left.plot(SHOWN, shown, "o", color=RED, ms=5, mec="white")
    left.set_xlim(0.0, 20.0)
    left.set_xlabel("time [s]")
    left.set_ylabel("spin about the vertical [rad/s]")
    dress(left)
    draw_path(right, motion)
    right.set_title("path of the contact point", fontsize=10, color=INK)
    write_whole(Path(__file__).with_name("rattleback.png"), png(figure, 110))


if __name__ == "__main__":
    main()
