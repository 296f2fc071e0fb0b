"""A user's own effects in the verbs: `--effects FILE.py` runs a file; a terminal is asked about a bundle's code."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from softmap_edge.bundle import builtin_model, load_bundle
from softmap_edge.errors import SoftmapError
from softmap_edge.model import Model
from softmap_edge.own_effect import load_effect


def effects_argument(parser: argparse.ArgumentParser, more: str = "") -> None:
    """Declare `--effects`, the same for every verb that loads a model; `more` says what else it takes."""
    parser.add_argument(
        "--effects",
        action="append",
        default=[],
        metavar="FILE.py",
        help=f"load a user-defined effect from FILE.py; may be repeated{more}",
    )


def load_own(args: argparse.Namespace) -> list[str]:
    """Load the files of `--effects`; return the names of their effects."""
    for path in args.effects:
        if not path.endswith(".py"):
            raise SoftmapError(f"--effects {path}: no Python file; `softmap effects new NAME` writes one")
    return [load_effect(path).name for path in args.effects]


def open_model(path: str | None) -> Model:
    """Return the model of a bundle, the built-in finger without one; its own code runs if the user says so."""
    return builtin_model() if path is None else load_bundle(path, ask)


def ask(file: Path, sha256: str) -> bool:
    """Ask on a terminal whether the code of a bundle may run; without a terminal it may not."""
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return False
    print(
        f"This bundle brings an effect as Python code: {file}\n  sha256 {sha256}\n"
        "It runs with your rights; read it first. Run it? [y/N] ",
        end="",
        file=sys.stderr,
        flush=True,
    )
    return sys.stdin.readline().strip().lower() in ("y", "yes")
