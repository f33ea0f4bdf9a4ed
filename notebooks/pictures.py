"""Draws the pictures of the README: `python notebooks/pictures.py`.

Three of them are results of recipes of the gallery, and one is a motion.
"""

import contextlib
import io
import os
import tempfile
from pathlib import Path
from typing import Any

import matplotlib as mpl


mpl.use("agg")

import matplotlib.pyplot as plt
import numpy as np
from figures import code_of

import twistorjax as tj


FOLDER = Path(__file__).parent
PICTURES = FOLDER / "pictures"


def result_of(recipe: str) -> dict[str, Any]:
    """Run the code of a page of the gallery, and return its variables."""
    (code,) = code_of((FOLDER / "gallery" / f"{recipe}.md").read_text())
    variables: dict[str, Any] = {}
    with (
        tempfile.TemporaryDirectory() as folder,
        contextlib.chdir(folder),
        contextlib.redirect_stdout(io.StringIO()),
    ):
        exec(code, variables)
    plt.close("all")
    return variables


def panels(ratios: tuple[float, float]) -> Any:
    """Create two axes beside each other, and return them and the figure."""
    figure, axes = plt.subplots(
        1, 2, figsize=(8.0, 3.4), layout="constrained", width_ratios=ratios
    )
    return figure, *axes


def save(figure: Any, name: str) -> None:
    """Write a picture, and close its figure."""
    figure.savefig(PICTURES / f"{name}.png", dpi=90)
    plt.close(figure)


def guide() -> None:
    """Draw a folded guide at the end of its stroke, and its support."""
    found = result_of("folded-guide")
    slide, middle = tj.Drive("table", x=5e-3), found["middle"]
    mechanism = found["guide"]
    figure, left, right = panels((1.25, 1.0))
    moved = tj.equilibrium(mechanism, drives=[slide])
    tj.draw(mechanism, moved, axes=left, names=False)
    stroke = tj.stiffness_over_stroke(mechanism, slide, middle, positions=40)
    right.semilogy(1e3 * stroke.travel, stroke.support["y"], label="support")
    right.semilogy(1e3 * stroke.travel, stroke.driving, label="driving")
    right.set(xlabel="stroke (mm)", ylabel="stiffness (N/m)", ylim=(300, 3e7))
    right.grid(alpha=0.3)
    right.legend()
    save(figure, "guide")


def amplifier() -> None:
    """Draw a rhombus amplifier, colored by stress."""
    found = result_of("amplifier")
    figure, axes = plt.subplots(figsize=(8.0, 3.4), layout="constrained")
    tj.draw(
        found["driven"],
        found["found"],
        magnify=10,
        color="stress",
        names=False,
        axes=axes,
    )
    save(figure, "amplifier")


def switch() -> None:
    """Draw both states of a bistable switch, and the path between them."""
    found = result_of("bistable-switch")
    mechanism, states = found["switch"], found["states"]
    figure, left, right = panels((1.6, 1.0))
    tj.draw(mechanism, states.poses[2], axes=left, names=False)
    path = tj.path(mechanism, loads=[found["push"]], load_factors=(-0.2, 0.5))
    heights = 1e3 * np.asarray(path.displacement("shuttle"))[:, 2]
    forces, stable = (
        10 * np.asarray(path.load_factors),
        np.asarray(path.stable),
    )
    for chosen, style, label in (
        (stable, "-", "stable"),
        (~stable, ":", "unstable"),
    ):
        right.plot(
            np.where(chosen, -heights, np.nan),
            np.where(chosen, forces, np.nan),
            style,
            label=label,
        )
    right.set(xlabel="travel (mm)", ylabel="force (N)")
    right.grid(alpha=0.3)
    right.legend()
    save(figure, "switch")


def lattice() -> None:
    """Animate a lattice of rotating squares that is compressed."""
    found = result_of("lattice")
    shares = (1 - np.cos(np.linspace(0, 2 * np.pi, 24, endpoint=False))) / 2
    poses = [
        tj.equilibrium(
            found["squares"],
            drives=[
                tj.Drive(name, y=-0.08 * share * found["side"])
                for name in found["top"]
            ],
        ).poses
        for share in shares
    ]
    figure, axes = plt.subplots(figsize=(6.6, 3.4), layout="constrained")
    animation = tj.animate(
        found["squares"], np.stack(poses), color="angle", axes=axes
    )
    os.environ.setdefault("SOURCE_DATE_EPOCH", "0")
    animation.save(PICTURES / "lattice.gif", writer="pillow", dpi=70)
    plt.close(figure)


if __name__ == "__main__":
    for picture in (guide, amplifier, switch, lattice):
        picture()
