"""Find the public recordings and meshes of some benchmarks and pages (`make data`)."""

from __future__ import annotations

from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def find(name: str) -> Path | None:
    """Return the folder of one data set (`trunk`, `tdcr`, `beam`, `moe_finger`), or None."""
    return next(
        (p for p in (ROOT / "data" / name, ROOT.parent / "shared/data" / name) if p.is_dir()), None
    )


def find_or_say(name: str) -> Path | None:
    """Return the folder of one data set, or report that it is missing and return None."""
    folder = find(name)
    if folder is None:
        print(f"not run: the data set '{name}' is absent; `make data` brings it")
    return folder
