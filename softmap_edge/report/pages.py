"""Write self-contained HTML pages from the templates in `templates/`.

A page loads nothing: images are embedded, there is no script, and the content policy forbids both.
Every value in a template is escaped, and unprintable characters are written as escapes.
"""

from __future__ import annotations

import base64
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from softmap_edge.files.numbers import mm, percent
from softmap_edge.files.printable import printable

TEMPLATES = Path(__file__).with_name("templates")
INSTALL = "pip install 'softmap-edge[report]'"


@dataclass(frozen=True)
class Card:
    """A number at the top of a page; `tone` is before, after or floor."""

    label: str
    value: str
    note: str
    tone: str


@dataclass(frozen=True)
class Picture:
    """An image (PNG or SVG) with the title of its section, a description, and its caption."""

    title: str
    image: bytes
    alt: str
    note: str = ""

    @property
    def source(self) -> str:
        """The data URI of the image."""
        kind = "image/png" if self.image.startswith(b"\x89PNG") else "image/svg+xml"
        return f"data:{kind};base64,{base64.b64encode(self.image).decode()}"


def render(template: str, page: object, *folders: Path) -> str:
    """Return a page as HTML.

    Args:
        template: name of the template
        page: its content, available as `page`
        folders: more folders with templates
    """
    return _environment(*folders).get_template(template).render(page=page)


def _environment(*folders: Path) -> Environment:
    environment = Environment(
        loader=FileSystemLoader([TEMPLATES, *folders]),
        autoescape=True,
        finalize=_shown,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"mm": mm, "percent": percent}
    return environment


def _shown(value: object) -> str:
    """Return the shown form of a value: markup unchanged, all else as printable text."""
    return value if isinstance(value, Markup) else printable(str(value))


def pictures_missing() -> str | None:
    """Return the command that installs matplotlib for the figures; None if it is installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError:
        return INSTALL
    return None
