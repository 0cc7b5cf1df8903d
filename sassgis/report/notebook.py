"""What a notebook shows of a result: the answer in short, the warnings, the first figure."""

from __future__ import annotations

from html import escape
from pathlib import Path

from sassgis.report.page import ReportContext, data_uri, sensible


def in_short(report: ReportContext, folder: Path) -> str:
    """Give the answer of a report as a piece of HTML, with a link to the whole in its folder."""
    rows = "".join(
        f'<tr><th style="text-align: left">{escape(name)}</th>'
        f'<td style="text-align: left">{escape(sensible(value))}</td></tr>'
        for name, value in report.summary
    )
    warnings = "".join(f"<li>⚠ {escape(text)}</li>" for text in report.warnings)
    pictures = "".join(
        f'<figure style="margin: 0"><img src="{data_uri(figure.png)}" '
        f'alt="{escape(figure.alt or figure.title)}" style="max-width: 48rem; width: 100%">'
        f"<figcaption>{escape(figure.title)}. {escape(figure.caption)}</figcaption></figure>"
        for figure in report.figures[:1]
    )
    page = folder / "report.html"
    return (
        f"<div><strong>{escape(report.title)}</strong><table><tbody>{rows}</tbody></table>"
        + (f"<ul>{warnings}</ul>" if warnings else "")
        + f'{pictures}<a href="{escape(page.as_posix())}">{escape(page.as_posix())}</a></div>'
    )
