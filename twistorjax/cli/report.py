"""`twistorjax report`: one page about a mechanism in a file."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from html import escape
from io import StringIO
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import typer

from .._utils.html import page
from .._utils.progress import activity
from .common import (
    check_page,
    load_mechanism,
    MechanismFile,
    prepare_jax,
    reporting_errors,
)
from .solve import draw_solution, DriveOption, inputs, LoadOption


class Section(NamedTuple):
    """A part of the page: how its result is computed and drawn."""

    title: str
    compute: Callable[[], Any]
    draw: Callable[[Any], Any] | None = None


def report(
    mechanism: MechanismFile,
    out: Annotated[
        Path, typer.Option(help="The page: an .html file.", callback=check_page)
    ] = Path("report.html"),
    load: LoadOption = None,
    drive: DriveOption = None,
) -> None:
    """Write a page about a mechanism: stiffness, vibrations, and equilibrium.

    It has the over-constraints, the stiffness of each body in the plane and out of it,
    the vibrations, and, under the loads, the equilibrium, the stresses, and the range of
    motion. What cannot be computed is explained.

    Example: twistorjax report guide.json --load table:5,0 --out guide.html
    """
    prepare_jax()
    model = load_mechanism(mechanism)
    sections = _sections(model, *inputs(load, drive))
    title = Path(mechanism).stem
    # Most of the time is compilation, for which two processors are used.
    with activity(f"report on {title}"), ThreadPoolExecutor(2) as pool:
        found = pool.map(_computed, sections)
        parts = [
            _html(section, *each) for section, each in zip(sections, found, strict=True)
        ]
    body = "\n".join([f"<h1>{escape(title)}</h1>", *parts])
    with reporting_errors("--out cannot be written: "):
        out.write_text(page(title, body), encoding="utf-8")
    print(f"saved to {out}")


def _sections(model: Any, loads: list, drives: list) -> list[Section]:
    """List the parts of the page."""
    from ..plotting.drawing import draw
    from ..plotting.oblique import draw_out_of_plane
    from ..solve.constraint_analysis import constraint_analysis
    from ..solve.equilibrium import equilibrium
    from ..solve.out_of_plane import out_of_plane
    from ..solve.port_compliance import port_compliance
    from ..solve.range_of_motion import range_of_motion
    from ..solve.vibrations import vibrations

    free = [name for row, name in enumerate(model.names) if not model.is_fixed(row)]

    def under_loads() -> Any:
        return equilibrium(model, loads=loads, drives=drives)

    def stiffness() -> str:
        return "\n\n".join(str(port_compliance(model, name)) for name in free)

    @cache
    def support() -> Any:
        return out_of_plane(model)

    sections = [
        Section("Mechanism", lambda: model, draw),
        Section("Constraints", lambda: constraint_analysis(model)),
        Section("Stiffness in the plane", stiffness),
        Section("Stiffness out of the plane", lambda: _support(support(), free)),
        Section("Vibrations in the plane", lambda: vibrations(model)),
        Section(
            "Vibrations out of the plane",
            lambda: support().vibrations(),
            lambda found: draw_out_of_plane(model, found),
        ),
    ]
    if loads or drives:
        sections[1:1] = [
            Section(
                "Equilibrium",
                under_loads,
                lambda found: draw_solution(model, found, loads),
            ),
            Section(
                "Range of motion",
                lambda: range_of_motion(model, loads=loads, drives=drives),
            ),
        ]
    return sections


def _support(support: Any, free: list[str]) -> str:
    """Return the stiffness of bodies out of the plane, if they may tilt, as a table."""
    import numpy as np

    width = max(map(len, [*free, "body"]))
    heads = ("along z (N/m)", *(f"tilt about axis {k} (N m/rad)" for k in (1, 2)))
    lines = ["  ".join([f"{'body':<{width}}", *heads])]
    for name in free:
        values = 1 / np.diagonal(np.asarray(support.compliance_at(name)))
        cells = (f"{v:>{len(head)}.6g}" for v, head in zip(values, heads, strict=True))
        lines.append("  ".join([f"{name:<{width}}", *cells]))
    return "\n".join(lines)


def _computed(section: Section) -> tuple[Any, str]:
    """Return a result and its text, or the reason why it cannot be computed, as HTML."""
    try:
        result = section.compute()
    except (ValueError, RuntimeError) as error:
        return None, f"<p>Not computed: {escape(str(error))}</p>"
    text = str(result)
    if (stresses := getattr(result, "stresses", None)) is not None:
        text += f"\n\n{stresses}"
    return result, f"<pre>{escape(text)}</pre>"


def _html(section: Section, result: Any, text: str) -> str:
    """Return a part of the page."""
    figure = ""
    if section.draw is not None and result is not None:
        image = StringIO()
        drawing = section.draw(result).figure
        drawing.savefig(image, format="svg", bbox_inches="tight")
        figure = image.getvalue()
        figure = figure[figure.index("<svg") :]
    return f"<h2>{section.title}</h2>\n{text}\n{figure}"
