"""Code that the user allows to run: `--effects FILE.py`, `--trust-onnx`.

On a terminal, the user is asked about the code of a bundle.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

from softmap_edge.errors import SoftmapError
from softmap_edge.model.bundle import builtin_model, load_bundle
from softmap_edge.model.model import Model
from softmap_edge.model.user_effect import load_effect

BUILTIN = "builtin"  # name of the built-in finger where a bundle is asked for
# value of --trust-onnx; valid for this process, like the effects of --effects
_trust_onnx: list[bool] = []


class OwnOptions(Protocol):
    """Options that `effects_argument` declares."""

    @property
    def effects(self) -> Sequence[str]: ...
    @property
    def trust_onnx(self) -> bool: ...


def effects_argument(parser: argparse.ArgumentParser, more: str = "") -> None:
    """Declare `--effects` and `--trust-onnx`, the same for every command that loads a model.

    Args:
        parser: parser of the command
        more: additional help text of `--effects`
    """
    parser.add_argument(
        "--effects",
        action="append",
        default=[],
        metavar="FILE.py",
        help=f"load a user-defined effect from FILE.py; may be repeated{more}",
    )
    parser.add_argument(
        "--trust-onnx",
        action="store_true",
        help=(
            "let onnxruntime run a network of the bundle that the core does not read, in a child "
            "process with limits"
        ),
    )


def load_own(args: OwnOptions) -> list[str]:
    """Load the files of `--effects` and store `--trust-onnx`; return the names of the effects."""
    _trust_onnx[:] = [args.trust_onnx]
    for path in args.effects:
        if not path.endswith(".py"):
            raise SoftmapError(
                f"--effects {path}: no Python file; `softmap model effects new NAME` writes one"
            )
    return [load_effect(path).name for path in args.effects]


def open_model(path: str | None) -> Model:
    """Return a bundle's model, or the built-in finger; a bundle's code runs only if allowed."""
    builtin = path is None or (path == BUILTIN and not Path(path).exists())
    return builtin_model() if builtin else load_bundle(str(path), ask, ask_onnx)


def ask_onnx(file: Path, sha256: str) -> bool:
    """Return whether onnxruntime may run a graph: `--trust-onnx`, or the answer on a terminal."""
    return any(_trust_onnx) or _yes(
        f"This bundle brings a graph that only onnxruntime runs: {file}\n  sha256 {sha256}\n"
        "onnxruntime is not made for files that you do not trust. Run it, in a child process "
        "with limits? [y/N] "
    )


def ask(file: Path, sha256: str) -> bool:
    """Ask on a terminal whether the code of a bundle may run; without a terminal it may not."""
    return _yes(
        f"This bundle brings an effect as Python code: {file}\n  sha256 {sha256}\n"
        "It runs with your rights; read it first. Run it? [y/N] "
    )


def _yes(question: str) -> bool:
    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return False
    print(question, end="", file=sys.stderr, flush=True)
    return sys.stdin.readline().strip().lower() in ("y", "yes")
