"""The look of the HTML pages: one page template with its style sheet, what stands on it, the colour of each verdict."""

from __future__ import annotations

import base64
import html
from collections.abc import Iterable
from typing import Any

from softmap_edge.files.printable import printable

# Which tone a verdict's badge has: good, warn, bad or calm.
TONES = {
    "identified": "good",
    "ambiguous": "warn",
    "partly_explained": "warn",
    "nothing": "calm",
    "cannot_tell": "calm",
    "measurement_fault": "bad",
}

PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; style-src 'unsafe-inline'">
<title>@TITLE@</title>
<style>
:root { --ink: #1f2933; --soft: #52606d; --line: #e4e8ee; --before: #cf5c36; --after: #1f7a8c; --floor: #7d8597;
  color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0; background: #f5f6f8; color: var(--ink); line-height: 1.5;
  font-family: system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
main { max-width: 1080px; margin: 0 auto; padding: 40px 24px 64px; }
header { margin-bottom: 24px; }
.eyebrow { margin: 0 0 14px; color: var(--soft); font-size: 13px; letter-spacing: .06em; text-transform: uppercase; }
h1 { margin: 10px 0 10px; font-size: 29px; line-height: 1.25; font-weight: 650; letter-spacing: -.01em; max-width: 30em;
  overflow-wrap: anywhere; }
.about { margin: 0; color: var(--soft); font-size: 14px; overflow-wrap: anywhere; }
.badge { display: inline-block; padding: 4px 12px; border-radius: 999px; font-size: 13px; font-weight: 600; }
.good { background: #d9efe5; color: #14573c; } .warn { background: #fbecc9; color: #7a4d05; }
.bad { background: #f9dcd5; color: #85260f; } .calm { background: #e2e7ee; color: #364152; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(190px, 1fr)); gap: 14px; margin-bottom: 18px; }
.card { background: #fff; border: 1px solid var(--line); border-top: 4px solid var(--floor); border-radius: 10px;
  padding: 14px 18px; }
.card.before { border-top-color: var(--before); } .card.after { border-top-color: var(--after); }
.card b { display: block; font-size: 27px; font-weight: 650; font-variant-numeric: tabular-nums; }
.card span { display: block; font-size: 14px; } .card i { font-style: normal; color: var(--soft); font-size: 12.5px; }
section { background: #fff; border: 1px solid var(--line); border-radius: 10px; padding: 20px 24px;
  margin-bottom: 18px; }
h2 { margin: 0 0 12px; font-size: 17px; font-weight: 650; }
img { display: block; width: 100%; height: auto; }
.note { margin: 10px 0 0; color: var(--soft); font-size: 13px; }
table { width: 100%; border-collapse: collapse; font-size: 14px; font-variant-numeric: tabular-nums; }
th { text-align: left; color: var(--soft); font-weight: 500; font-size: 13px; vertical-align: bottom; }
th, td { padding: 8px 14px 8px 0; border-bottom: 1px solid var(--line); }
td { vertical-align: top; overflow-wrap: anywhere; }
tr:last-child td { border-bottom: 0; }
small { color: var(--soft); }
code { font-family: ui-monospace, "DejaVu Sans Mono", Menlo, Consolas, monospace; font-size: 13px; }
.flag { background: #fbecc9; color: #7a4d05; border-radius: 4px; padding: 0 6px; font-size: 12px; }
.columns { display: grid; grid-template-columns: repeat(auto-fit, minmax(420px, 1fr)); gap: 18px; margin-bottom: 18px; }
.columns section { margin: 0; }
dl { margin: 0; font-size: 14px; } dt { font-weight: 600; }
dd { margin: 0 0 10px; color: var(--soft); overflow-wrap: anywhere; }
details { color: var(--soft); font-size: 13px; padding: 4px 2px; }
pre { white-space: pre-wrap; overflow-wrap: anywhere; }
@media print { body { background: #fff; } section, .card { break-inside: avoid; } }
</style>
</head>
<body><main>
@BODY@
</main></body>
</html>
"""


def escaped(value: Any) -> str:
    """Return a text as HTML that shows it and nothing else."""
    return html.escape(printable(str(value)), quote=True)


def picture(data: bytes, alt: str) -> str:
    """Return a picture (PNG or SVG) as HTML that holds it."""
    kind = "image/png" if data.startswith(b"\x89PNG") else "image/svg+xml"
    return f'<img alt="{escaped(alt)}" src="data:{kind};base64,{base64.b64encode(data).decode()}">'


def cards(rows: Iterable[tuple[str, str, str, str]]) -> str:
    """Return cards as HTML: (label, value, note, tone) of each."""
    return "".join(
        f'<div class="card {tone}"><b>{escaped(value)}</b><span>{escaped(label)}</span><i>{escaped(note)}</i></div>'
        for label, value, note, tone in rows
    )


def section(title: str, content: str, note: str = "") -> str:
    """Return a part of the page under its title, with a note below."""
    caption = f'<p class="note">{note}</p>' if note else ""
    return f"<section><h2>{escaped(title)}</h2>{content}{caption}</section>"
