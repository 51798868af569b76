"""The report of a fit: one HTML file that needs nothing beside it, for a person to look at and to keep.

Pictures (target, model, difference), what happened step by step, every free number with its start, value and range,
what the pictures do not tell, and the warnings of the run.
"""

from __future__ import annotations

import base64
import html
import importlib.metadata
import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ..formats.limits import as_path
from ..formats.quantize import quantize
from ..formats.safe_write import written_whole
from ..given import plain, several
from ..image import encode
from ..image.encode import Transfer
from ..scene.fields import choice, string, strings
from ..tracing import refuse_inside
from .fitting import Fit
from .pictures import ViewPictures, view_pictures
from .residuals import is_limit
from .steps import Step
from .views import View

MAX_ROWS = 500
"""Free numbers that are listed; a texture has more than a person reads."""


UNFOLDED = 30
"""Steps up to which their table is open."""
SMALL = 300
"""Pixels across, below which a picture is shown in its pixels instead of blurred."""
SHOWN = 0.995
"""Share of the differences that lie within the colours of the map."""


def write_report(
    path: str | Path,
    result: Fit,
    views: View | Sequence[View],
    *,
    title: str = "Fit",
    transfer: Transfer | Sequence[Transfer] = "none",
    warnings: Sequence[str] | None = None,
) -> None:
    """Write the report page (written whole or not at all).

    Args:
        path: the .html file.
        result: what `fit` returned.
        views: the views that it was given.
        title: the page's heading.
        transfer: "srgb" if the views' numbers are linear light, so that they look right on the page; one for all, or
            one a view.
        warnings: what was said while scene and pictures were read and fitted, a sentence each; None: not known.

    Raises:
        ValueError: `result` is not what `fit` returns; views of another number or size than the fit had; transfers of
            another number.
    """
    refuse_inside("write_report")
    if not isinstance(result, Fit):
        raise ValueError(f"result: expected a Fit, got {type(result).__name__}")
    path = as_path("write_report: path", path)
    title = string("title", title)
    warnings = None if warnings is None else strings("warnings", warnings)
    transfers: list[Any] = [choice("none", "srgb")("transfer", own) for own in several(transfer)]
    each = several(views)
    pictures = view_pictures(result, each)
    if isinstance(plain(transfer), str):
        transfers *= len(each)
    if len(transfers) != len(each):
        raise ValueError(f"transfer: expected one for each of {len(each)} views, got {len(transfers)}")
    shown: list[Transfer] = [
        own for own, view in zip(transfers, each, strict=True) if view.samples.pixel_slots is not None
    ]
    page = report_page(result, pictures, shown, title=title, warnings=warnings)
    with written_whole(path) as draft:
        draft.write_text(page, encoding="utf-8", errors="replace")


def report_page(
    result: Fit,
    pictures: Sequence[ViewPictures],
    transfers: Sequence[Transfer],
    *,
    title: str,
    warnings: Sequence[str] | None = None,
) -> str:
    """The page as text."""
    verdict = "good" if result.converged else "bad"
    sections = [_view_section(one, transfer) for one, transfer in zip(pictures, transfers, strict=True)]
    return f"""<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>{html.escape(title)}</title><style>{_STYLE}</style></head><body>
<h1>{html.escape(title)}</h1>
<p class="{verdict}">{html.escape(result.message)}</p>
<p>{_setting(result)}</p>
<h2>Pictures</h2>
{"".join(sections) or "<p>Samples without pixels: nothing to show.</p>"}
<h2>Steps</h2>
{_convergence_chart(result.history)}
{_steps_table(result.history)}
<h2>Free numbers</h2>
{_numbers_table(result)}
{_textures(result)}
<h2>What the pictures do not tell</h2>
{_sentences(result.uncertainty.messages(), "The pictures determine every free number.")}
{"" if warnings is None else "<h2>Warnings</h2>" + _sentences(warnings, "None.")}
</body></html>
"""


def _setting(result: Fit) -> str:
    """What was fitted by what, in a line."""
    texels = sum(block.size for block in result.problem.parameters.blocks)
    seconds = result.history[-1].seconds if result.history else 0.0
    parts = [
        f"{len(result.labels)} free numbers" + (f" and {texels} of textures" if texels else ""),
        f"{result.description.residuals} residuals",
        {"squares": "least squares"}.get(result.problem.loss_kind, f"{result.problem.loss_kind} loss"),
        str(result.problem.parameters.start.dtype),
        f"{seconds:.2f} s with compilation",
        *(f"{name} {importlib.metadata.version(name)}" for name in ("jaxlight", "jax")),
    ]
    return ", ".join(parts) + "."


def _view_section(view: ViewPictures, transfer: Transfer) -> str:
    difference, limits = view.difference, is_limit(view.target, view.dark, view.saturated)
    sizes = np.abs(difference[view.used])
    largest = float(np.max(sizes, initial=0))
    # A few pixels at rims must not make all others look right.
    scale = float(np.quantile(sizes, SHOWN)) if sizes.size else 0.0
    rms = float(np.sqrt(np.mean(difference[view.used] ** 2))) if np.any(view.used) else math.nan
    shown = np.where(view.used[..., None], _diverging(difference.mean(axis=-1) / (scale or 1.0)), 0.5)
    figures = [
        ("target", encode(view.target, transfer)),
        ("model", encode(view.model, transfer)),
        (
            f"model - target, blue -{scale:.3g} to red +{scale:.3g}, {SHOWN:.1%} within; grey: not looked at"
            f"{'; 0 where a limit of the sensor is kept' if np.any(limits) else ''}",
            shown,
        ),
    ]
    heading = f"{html.escape(view.name)}: difference RMS {rms:.3g}, largest {largest:.3g}"
    return f"<h3>{heading}</h3>{_figures(view.name, figures)}"


def _figures(of: str, figures: Sequence[tuple[str, Any]]) -> str:
    """Captions and pictures of one thing, side by side."""
    cells = "".join(
        f"<figure>{_png(image, f'{of}: {caption}')}<figcaption>{caption}</figcaption></figure>"
        for caption, image in figures
    )
    return f'<div class="pictures">{cells}</div>'


def _png(image: Any, described: str) -> str:
    levels = quantize(image)
    data = io.BytesIO()
    Image.fromarray(levels).save(data, "PNG")
    kind = ' class="small"' if levels.shape[1] < SMALL else ""
    content = base64.b64encode(data.getvalue()).decode()
    return f'<img{kind} src="data:image/png;base64,{content}" alt="{html.escape(described)}">'


def _diverging(values: np.ndarray) -> np.ndarray:
    """[-1, 1] to blue, white, red; what lies beyond is as the ends."""
    size = np.minimum(np.abs(values), 1)[..., None]
    end = np.where(values[..., None] > 0, (0.70, 0.02, 0.12), (0.02, 0.19, 0.58))
    return (1 - size) + size * end


def _convergence_chart(history: Sequence[Step]) -> str:
    """Residual RMS over the evaluations, logarithmic."""
    points = [(step.step, step.rms, step.accepted) for step in history if step.rms > 0 and math.isfinite(step.rms)]
    if len(points) < 2:
        return ""
    width, height, left, bottom = 640, 220, 60, 30
    logs = [math.log10(rms) for _, rms, _ in points]
    low, high = math.floor(min(logs)), max(math.ceil(max(logs)), math.floor(min(logs)) + 1)
    last = max(points[-1][0], 1)

    def place(step: int, log: float) -> tuple[float, float]:
        x = left + step / last * (width - left - 10)
        return x, 10 + (high - log) / (high - low) * (height - bottom - 10)

    path = " ".join(f"{x:.1f},{y:.1f}" for x, y in (place(p[0], log) for p, log in zip(points, logs, strict=True)))
    dots = "".join(
        f'<circle cx="{place(step, log)[0]:.1f}" cy="{place(step, log)[1]:.1f}" r="3" '
        f'fill="{"#1b6ca8" if accepted else "#fff"}" stroke="#1b6ca8"/>'
        for (step, _, accepted), log in zip(points, logs, strict=True)
    )
    grid = "".join(
        f'<line x1="{left}" x2="{width - 10}" y1="{place(0, e)[1]:.1f}" y2="{place(0, e)[1]:.1f}" stroke="#ddd"/>'
        f'<text x="{left - 8}" y="{place(0, e)[1] + 4:.1f}" text-anchor="end">1e{e}</text>'
        for e in range(low, high + 1)
    )
    ends = "".join(
        f'<text x="{place(step, low)[0]:.1f}" y="{height - 8}" text-anchor="middle">{step}</text>'
        for step in (0, points[-1][0])
    )
    middle, halfway = (left + width - 10) / 2, (height - bottom + 10) / 2
    titles = (
        f'<text x="{middle:.1f}" y="{height - 8}" text-anchor="middle">step</text>'
        f'<text transform="translate(14 {halfway:.1f}) rotate(-90)" text-anchor="middle">residual RMS</text>'
    )
    return (
        f'<svg viewBox="0 0 {width} {height}" width="{width}" role="img" aria-label="residual RMS by step">'
        f"{grid}{ends}{titles}"
        f'<polyline points="{path}" fill="none" stroke="#1b6ca8"/>{dots}</svg>'
        "<p>Residual RMS by step; open circles: steps that were tried and refused.</p>"
    )


def _steps_table(history: Sequence[Step]) -> str:
    rows = "".join(
        f"<tr><td>{step.step}</td><td>{'taken' if step.accepted else 'refused'}</td><td>{step.loss:.6g}</td>"
        f"<td>{step.rms:.6g}</td><td>{step.gradient:.2e}</td><td>{step.in_tolerances}</td>"
        f"<td>{step.damping:.1e}</td><td>{100 * step.part:.3g} %</td><td>{step.seconds:.2f}</td></tr>"
        for step in history
    )
    heads = ("step", "", "loss", "residual RMS", "gradient", "step / tolerance", "damping", "samples", "seconds")
    unfolded = " open" if len(history) <= UNFOLDED else ""
    return f"<details{unfolded}><summary>Every step</summary><table>{_heads(heads)}{rows}</table></details>"


def _numbers_table(result: Fit) -> str:
    parameters = result.problem.parameters
    start, lower, upper = (np.asarray(a, np.float64) for a in (parameters.start, parameters.lower, parameters.upper))
    known = result.uncertainty
    bounds = dict(known.at_bound)
    rows = []
    for i, label in enumerate(result.labels[:MAX_ROWS]):
        error = known.standard_error[i]
        unknown = "not determined" if np.isfinite(known.noise) else "error not known"
        note = f"at its {bounds[label]} bound" if label in bounds else "" if np.isfinite(error) else unknown
        rows.append(
            f"<tr><td>{html.escape(label)}</td><td>{start[i]:.6g}</td><td>{float(result.values[i]):.6g}</td>"
            f"<td>{f'{error:.2g}' if np.isfinite(error) else '-'}</td>"
            f"<td>{_range(lower[i], upper[i])}</td><td>{note}</td></tr>"
        )
    heads = ("number", "start", "fitted", "standard error", "range", "")
    more = f"<p>and {len(result.labels) - MAX_ROWS} more</p>" if len(result.labels) > MAX_ROWS else ""
    return f"<table>{_heads(heads)}{''.join(rows)}</table>{more}"


def _range(lower: float, upper: float) -> str:
    if math.isinf(lower) and math.isinf(upper):
        return "any"
    if math.isinf(upper):
        return f"from {lower:.3g}"
    return f"up to {upper:.3g}" if math.isinf(lower) else f"{lower:.3g} to {upper:.3g}"


def _textures(result: Fit) -> str:
    """Whole textures that were free, before and after; their row 0 is at the bottom."""
    sections = []
    parameters = result.problem.parameters
    for block in parameters.blocks:
        figures = []
        for caption, values in (("start", parameters.start), ("fitted", result.state.values)):
            image = np.asarray(block.image(values))[::-1]
            figures.append((caption, np.broadcast_to(image, (*image.shape[:2], 3))))
        sections.append(f"<h3>{html.escape(block.path)}</h3>{_figures(block.path, figures)}")
    return "".join(sections)


def _sentences(sentences: Sequence[str], otherwise: str) -> str:
    listed = "".join(f"<li>{html.escape(sentence)}</li>" for sentence in sentences)
    return f"<ul>{listed}</ul>" if sentences else f"<p>{otherwise}</p>"


def _heads(names: Sequence[str]) -> str:
    return "<tr>" + "".join(f"<th>{name}</th>" for name in names) + "</tr>"


_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 70rem; margin: 2rem auto; padding: 0 1rem; color: #222 }
.pictures { display: grid; grid-template-columns: repeat(3, minmax(0, 1fr)); gap: 1rem }
figure { margin: 0 }
img { width: 100%; border: 1px solid #ccc; box-sizing: border-box }
img.small { image-rendering: pixelated }
figcaption { font-size: 85%; color: #555 }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; display: block; overflow-x: auto }
svg { max-width: 100%; height: auto }
td, th { padding: .15rem .9rem .15rem 0; text-align: right; border-bottom: 1px solid #eee }
td:first-child, th:first-child { text-align: left }
.good { color: #17692f; font-weight: 600 } .bad { color: #a01c1c; font-weight: 600 }
summary { cursor: pointer; margin: .5rem 0 }
svg text { font-size: 11px; fill: #555 }
"""
