"""The manifest of a bundle, with every field checked before anything else is read.

Pinned by tests/model/test_bundle.py.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

from softmap_edge.errors import BundleError, brief
from softmap_edge.files.atomic import Document, finite, own_text

# 2: scattered families, bodies without a mesh; 3: user-defined effects, design fields, steps; 4: a
# residual; 5: networks; 6: a calibration, handles; 7: limits (safety.toml); 8: outputs other than
# positions
SCHEMA = 8
KINDS = ("table", "scattered", "network", "rod")
EFFECT_NAME = re.compile(r"[a-z][a-z0-9_]{0,39}")  # of a user's own effect
_MOST = 16 << 20  # bytes of a JSON file
MAX_EFFECT_BYTES = 1 << 20  # of its file
MAX_ONNX_BYTES = 64 << 20  # the published network has 7 MB
LARGEST = 1e9  # mm, g, N, s: beyond any robot, and far from where float64 overflows in a product


def check_within(file: Path) -> None:
    """Raise BundleError if a file of a bundle is a link to a file outside its folder."""
    if file.is_symlink() and file.resolve().parent != file.parent.resolve():
        raise BundleError(
            f"{file.parent.name}: {file.name} is a link to a file outside the bundle; copy the "
            "bundle with its files (cp -rL)"
        )


def load_manifest(path: str | Path) -> Document:
    """Read and check `manifest.json` of a bundle folder."""
    file = Path(path) / "manifest.json"
    if not file.is_file():
        raise BundleError(
            f"{path}: not a bundle folder (no manifest.json); `softmap build` and `softmap learn` "
            "make one"
        )
    check_within(file)
    manifest = read_json(file)
    schema = manifest.get("schema")
    if not isinstance(schema, int) or isinstance(schema, bool) or schema < 1:
        raise BundleError(
            f"{file.parent.name}: manifest.json has schema {schema!r:.80}, expected a whole "
            "number from 1"
        )
    if schema > SCHEMA:
        raise BundleError(
            f"{file.parent.name}: written with bundle schema {schema}, this version reads up to "
            f"{SCHEMA}; pip install -U softmap-edge"
        )
    if manifest.get("kind") not in KINDS:
        raise BundleError(
            f"{file.parent.name}: kind of prior {manifest.get('kind')!r:.80}, known are "
            f"{', '.join(KINDS)}"
        )
    _require(manifest, "sha256", _file_hashes, "a table of at most 100 file names and their sha256")
    _require(manifest, "channels", lambda v: type(v) is int and 0 <= v <= 64, "a whole number 0…64")
    for name in ("robot", "command_unit", "written_by"):
        _require(manifest, name, _plain, "a printable text of at most 100 characters")
    _require(
        manifest, "length_unit", lambda v: v == "mm", "'mm': lengths of a bundle are in millimetres"
    )
    _require({"made_from": {}, **manifest}, "made_from", lambda v: isinstance(v, dict), "a table")
    _require(
        {"input": "present", **manifest},
        "input",
        lambda v: v in ("present", "goal"),
        "'present' or 'goal'",
    )
    for name in ("held_out_error_mm", "held_out_error_per_g_mm"):
        _require(
            {"held_out_error_per_g_mm": 0.0, **manifest}, name, _error, "a number in mm from 0"
        )
    _require(
        {"stiffness_known": True, **manifest},
        "stiffness_known",
        lambda v: isinstance(v, bool),
        "true or false",
    )
    _require(manifest, "gravity_reference", lambda v: _floats(v, 3), "three numbers")
    _require(
        manifest,
        "command_range",
        lambda v: isinstance(v, list) and len(v) == manifest["channels"] and all(map(_interval, v)),
        "a pair [low, high] a channel, low below high",
    )
    _require(
        {"output": {}, **manifest},
        "output",
        lambda v: isinstance(v, dict),
        "a table of names, unit, mm_per_unit",
    )
    _require(
        {"own_effects": {}, **manifest},
        "own_effects",
        _hashes,
        "a table of names and sha256, of at most 16",
    )
    return manifest


def _require(manifest: Document, key: str, fits: Callable[[object], bool], what: str) -> None:
    if key not in manifest or not fits(manifest[key]):
        raise BundleError(
            f"manifest.json: '{key}' is {manifest.get(key)!r:.80}, expected {what}; build or copy "
            "it again"
        )


def _plain(value: object) -> bool:
    return isinstance(value, str) and len(value) <= 100 and value.isprintable()


def _interval(value: object) -> bool:
    return isinstance(value, list) and _floats(value, 2) and bool(value[0] < value[1])


def _error(value: object) -> bool:
    return finite(value, LARGEST) and value >= 0


def _file_hashes(value: object) -> bool:
    return isinstance(value, dict) and len(value) <= 100 and all(map(_digest, value.values()))


def _hashes(value: object) -> bool:
    return (
        isinstance(value, dict)
        and len(value) <= 16
        and all(EFFECT_NAME.fullmatch(name) for name in value)
        and all(map(_digest, value.values()))
    )


def _digest(value: object) -> bool:
    return isinstance(value, str) and re.fullmatch("[0-9a-f]{64}", value) is not None


def _floats(value: object, length: int) -> bool:
    return (
        isinstance(value, list) and len(value) == length and all(finite(v, LARGEST) for v in value)
    )


def read_json(file: Path) -> Document:
    """Return the object in a JSON file of a bundle.

    Raises:
        BundleError: it is too large, or does not hold an object.
    """
    if file.stat().st_size > _MOST:
        raise BundleError(f"{file.name}: {file.stat().st_size} bytes, at most 16 MiB are read")
    try:
        document = json.loads(own_text(file, _MOST))
    except (ValueError, RecursionError) as fault:
        raise BundleError(
            f"{file.parent.name}: {file.name} is not readable JSON ({brief(fault)}); copy it again"
        ) from None
    if not isinstance(document, dict):
        raise BundleError(
            f"{file.parent.name}: {file.name} holds a {type(document).__name__}, expected a table"
        )
    return document
