"""The progress of an experiment: open questions of an earlier and a later diagnosis."""

from __future__ import annotations

from softmap_edge.diagnosis.text import alternative_name
from softmap_edge.files.atomic import Document
from softmap_edge.files.numbers import folded


def progress_lines(before: Document | None, after: Document) -> list[str]:
    """Return the earlier and the remaining open questions, for a terminal.

    Args:
        before: the earlier document softmap.diagnosis/2; None lists only the open questions now
        after: the later document
    """
    lines = [] if before is None else _open("Before", before)
    lines += _open("Now" if before is not None else "Open", after)
    if before is not None:
        gone = [name for name in _asked(before) if name not in _asked(after)]
        lines += _folded("Settled   " + (", ".join(gone) or "nothing yet"))
    return lines


def _open(title: str, document: Document) -> list[str]:
    found = (
        " + ".join(str(row.get("name")) for row in [*document["effects"], *document["faults"]])
        or "nothing named"
    )
    others = list(dict.fromkeys(alternative_name(row) for row in document["alternatives"]))
    hidden = [str(row.get("name")) for row in document["not_testable"]]
    verdict = str(document["verdict"]).replace("_", " ")
    line = f"{title:<9} {found} ({verdict}); alternatives: {', '.join(others) or 'none'}"
    return _folded(line + f"; not testable: {', '.join(hidden) or 'none'}")


def _asked(document: Document) -> list[str]:
    others = [alternative_name(row) for row in document["alternatives"]]
    return list(
        dict.fromkeys([*others, *(str(row.get("name")) for row in document["not_testable"])])
    )


def _folded(text: str) -> list[str]:
    text = "".join(c for c in text if c.isprintable())
    return folded(text, 0, 10)
