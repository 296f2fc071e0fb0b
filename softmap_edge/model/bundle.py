"""The bundle: the folder that carries a model from one machine to another.

Loading a bundle never runs code in it without permission.

manifest.json   schema version, kind of prior, units, hashes, held-out model error, origin; for a
                learned model `made_from` has `runs` (their hashes) and `learned_in`
                (`model/learned_in.py`)
prior.npz       the prior: a table (axes, coefficients, mean, modes), a scattered family (nodes,
                scale, power; the rest as a table), or a rod with the `coverage_…` of the commands
                that it was learned from
template.npz    rest points, triangles, tip, model-form error per feature; section, along and angle
                of a body without a mesh; handles, if not all vertices are
fields.npz      displacement fields per unit of loads and design changes, as modes over fewer
                commands; `second_…`: the second order of the loads
effects.json    the chain: names and parameters
prior.onnx      a trained prior; `prior.npz` then holds the tension of its tendons. A graph that
                only onnxruntime reads is run only if the user allows it, and becomes a table of
                its outputs (`table_from_onnxruntime`)
residual.npz    the residual learned on top of the prior (`softmap model adapt`), if any, as a
                scattered family, or
residual.onnx   as a network
NAME_step       next to an array of whole numbers NAME in an archive: NAME counts these steps
NAME.py         a user-defined effect of the chain, with its hash in the manifest. This code runs
                only if the user has loaded the same file before (`load_effect`) or confirms it
calibration.json   the map from servo ticks to commands (`softmap model calibrate`), if known
safety.toml     limits of the finger (`safety.py`); may be edited. A hash that differs from the
                manifest's is reported, and every limit is checked in any case
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from softmap_edge import _core
from softmap_edge.errors import BundleError, CalibrationError, SoftmapError, brief
from softmap_edge.files.atomic import (
    MOST_TEXT,
    Document,
    finite,
    own_text,
    replacement_of_folder,
    sha256_of,
)
from softmap_edge.files.npz import Arrays, read_npz, write_npz
from softmap_edge.model.manifest import (
    LARGEST,
    MAX_EFFECT_BYTES,
    MAX_ONNX_BYTES,
    check_within,
    load_manifest,
    read_json,
)
from softmap_edge.model.model import Model
from softmap_edge.model.safety import Safety, derived, read_safety
from softmap_edge.model.servo_calibration import Calibration
from softmap_edge.model.shapes import (
    BundleArrays,
    FieldArrays,
    Grid,
    ModeArrays,
    NetworkArrays,
    NumbersBefore,
    PriorArrays,
)
from softmap_edge.model.structure import Structure
from softmap_edge.model.template import Template
from softmap_edge.run.output import Output

if TYPE_CHECKING:
    from softmap_edge.model.user_effect import OwnEffect

_MAX_BYTES = 256 << 20
_MOST = {
    ".json": 16 << 20,
    ".npz": _MAX_BYTES,
    ".onnx": MAX_ONNX_BYTES,
    ".toml": MOST_TEXT,
    ".py": MAX_EFFECT_BYTES,
}
SAFETY = "safety.toml"
_FILES = ("prior.npz", "template.npz", "fields.npz", "effects.json")
# further files that the manifest may list
_PERHAPS = ("prior.onnx", "residual.onnx", "residual.npz", "calibration.json", SAFETY)
Trust = Callable[[Path, str], bool]


def save_bundle(model: Model, path: str | Path) -> Path:
    """Write `model` as a bundle folder at `path` and return it; equal models give equal bytes.

    An existing bundle is replaced.

    Raises:
        BundleError: `path` is something else, or a bundle with further files.
    """
    folder = Path(path).resolve()
    if model.arrays is None:
        raise BundleError(
            "this model has no arrays to write; build it, learn it, or load it from a bundle"
        )
    check_folder(folder)
    with replacement_of_folder(folder) as partial:
        _write(model, model.arrays, partial)
    return folder


def _write(model: Model, arrays: BundleArrays, partial: Path) -> None:
    """Write the files of a bundle into a folder."""
    files = list(_FILES)
    for name, network in arrays.networks().items():
        files.append(f"{name}.onnx")
        (partial / files[-1]).write_bytes(network)
    for name, content in arrays.contents().items():
        if content or f"{name}.npz" in _FILES:
            files += [] if f"{name}.npz" in _FILES else [f"{name}.npz"]
            write_npz(partial / f"{name}.npz", content)
    write_npz(partial / "template.npz", Template.of(model).to_npz())
    if model.calibration is not None:
        files.append("calibration.json")
        (partial / files[-1]).write_text(json.dumps(model.calibration.to_dict(), indent=1) + "\n")
    if model.safety is not None:
        files.append(SAFETY)
        narrowed = model.safety.within(model.command_range) or derived(model)
        assert narrowed is not None  # a model with limits has commands
        (partial / SAFETY).write_text(narrowed.to_toml(), encoding="utf-8")
    own = [effect for name, effect in _loaded().items() if name in model.chain_names]
    for effect in own:
        (partial / f"{effect.name}.py").write_bytes(effect.source)
    chain = {"chain": list(model.chain_names), "params": model.params}
    (partial / "effects.json").write_text(json.dumps(chain, indent=1, sort_keys=True) + "\n")
    from softmap_edge.version import __version__

    manifest = {
        "schema": _schema(model, files, bool(own)),
        "kind": model.kind,
        "robot": model.robot,
        "channels": model.channels,
        "command_unit": model.command_unit,
        "length_unit": "mm",
        "input": model.input,
        "command_range": model.command_range.tolist(),
        "gravity_reference": model.gravity_reference.tolist(),
        "held_out_error_mm": float(model.vertex_error_mm),
        "held_out_error_per_g_mm": float(model.error_per_g_mm),
        "stiffness_known": model.structure.stiffness_known,
        "made_from": dict(model.made_from),
        "written_by": f"softmap-edge {__version__}",
        "sha256": {name: sha256_of(partial / name) for name in files},
    }
    if model.output is not None:
        manifest["output"] = model.output.to_dict()
    if own:
        manifest["own_effects"] = {effect.name: effect.sha256 for effect in own}
    (partial / "manifest.json").write_text(
        json.dumps(manifest, indent=1, sort_keys=True, ensure_ascii=False) + "\n"
    )


def _loaded() -> Mapping[str, OwnEffect]:
    """Return the user-defined effects of this process by name.

    Their module is loaded only for models with effects.
    """
    from softmap_edge.model.user_effect import loaded

    return loaded()


def _schema(model: Model, files: list[str], own: bool) -> int:
    """Return the oldest schema that can store the model; a rod computes its own fields."""
    if model.output is not None:
        return 8
    if SAFETY in files:
        return 7
    if "calibration.json" in files or model.handles is not None:
        return 6
    if model.kind == "network" or "residual.onnx" in files:
        return 5
    if "residual.npz" in files:
        return 4
    designed = model.kind != "rod" and bool(set(model.fields) - set(_core.LOADS))
    in_steps = model.arrays is not None and model.arrays.prior.in_steps
    if own or designed or in_steps:
        return 3
    return 2 if model.kind == "scattered" or model.structure.body is not None else 1


def check_folder(folder: Path) -> None:
    """Raise BundleError if `folder` is not a bundle or holds other files: these are never lost."""
    if not folder.exists() or folder.is_dir() and not any(folder.iterdir()):
        return
    try:
        manifest = load_manifest(folder)
    except BundleError:
        raise BundleError(
            f"{folder} exists and is not a bundle; choose another name or remove it"
        ) from None
    ours = {
        "manifest.json",
        *_FILES,
        *_named(manifest),
        *(f"{name}.py" for name in manifest.get("own_effects", {})),
    }
    if foreign := sorted({entry.name for entry in folder.iterdir()} - ours):
        raise BundleError(
            f"{folder}: holds {foreign[0]} next to a bundle, which would be lost; take it out first"
        )


def load_bundle(
    path: str | Path, trust: Trust | None = None, trust_onnx: bool | Trust = False
) -> Model:
    """Read a bundle folder and return its model.

    Args:
        path: the folder.
            trust: called as `trust(file, sha256)` for each user-defined effect that is not loaded
                yet; returns whether its file may be run. None: no file is run.
            trust_onnx: whether onnxruntime may run a graph that the core cannot read, in a child
                process with limits of memory and time; or a function called as
                `trust_onnx(file, sha256)`.

    Raises:
            BundleError: it is damaged or too new, or holds code or a graph that the user has not
                allowed to run.
    """
    folder = Path(path)
    manifest = load_manifest(folder)
    for name in (
        *_FILES,
        *_named(manifest),
        *(f"{name}.py" for name in manifest.get("own_effects", {})),
    ):
        if not (folder / name).is_file():
            raise BundleError(
                f"{folder.name}: {name} is missing; copy the complete bundle folder again"
            )
        check_within(folder / name)
        _check_size(folder / name)
        if name != SAFETY and sha256_of(folder / name) != (
            manifest["sha256"] | _own_hashes(manifest)
        ).get(name):
            raise BundleError(
                f"{folder.name}: {name} is not the file that the manifest names (hash differs); "
                "copy it again"
            )
    for name, digest in manifest.get("own_effects", {}).items():
        _allow(folder / f"{name}.py", name, digest, trust)
    try:
        return _model(
            folder,
            manifest,
            trust_onnx if callable(trust_onnx) else lambda _file, _sha256: trust_onnx,
        )
    except BundleError:
        raise
    except (
        SoftmapError,
        KeyError,
        ValueError,
        TypeError,
        IndexError,
        OverflowError,
        MemoryError,
    ) as fault:
        raise BundleError(
            f"{folder.name}: its arrays do not fit together ({brief(fault)}); build or copy it "
            "again"
        ) from None


@cache
def builtin_model() -> Model:
    """Return the model of the built-in finger, which ships with the package; it is read once."""
    return load_bundle(Path(__file__).parents[1] / "data" / "finger")


def _allow(file: Path, name: str, digest: str, trust: Trust | None) -> None:
    """Load the effect `name` of a bundle; run `file` only if `trust` allows it."""
    from softmap_edge.model.user_effect import load_effect

    known = _loaded().get(name)
    if known is None:
        if trust is None or not trust(file, digest):
            raise BundleError(
                f"{file.parent}: its effect '{name}' is Python code, which is not run unasked; "
                f"read {file}, then allow it with --effects {file} (in Python: load_effect)"
            )
        known = load_effect(file, digest)
    if known.sha256 != digest or known.name != name:
        raise BundleError(
            f"{file.parent}: its effect '{name}' is a file of sha256 {digest[:12]}…, loaded is "
            f"{known.name} of {known.sha256[:12]}… ({known.file}); a name stands for one file, so "
            f"give --effects {file}"
        )


def _named(manifest: Document) -> list[str]:
    """Return the optional bundle files that the manifest lists."""
    return [name for name in _PERHAPS if name in manifest["sha256"]]


def _read_archive(folder: Path, file: str) -> Arrays:
    """Read an archive of a bundle.

    Its numbers must be finite and of plausible size, which prevents later overflow.
    """
    arrays = read_npz(folder / file, BundleError, _MAX_BYTES)
    for key, array in arrays.items():
        if array.dtype.kind not in "fiub" or not np.all(np.isfinite(array)):
            raise BundleError(
                f"{folder.name}: {file}: '{key}' is not all finite numbers; build it again"
            )
        low, high = (float(array.min()), float(array.max())) if array.size else (0.0, 0.0)
        if max(high, -low) > LARGEST or (key == "form_error_mm" and low < 0):
            raise BundleError(
                f"{folder.name}: {file}: '{key}' holds {low:.4g} to {high:.4g}, allowed is "
                f"{'0 to ' if key == 'form_error_mm' else '±'}{LARGEST:g}; build it again"
            )
        if key in ("triangles", "tip", "handles") and array.dtype.kind not in "iu":
            raise BundleError(
                f"{folder.name}: {file}: '{key}' holds {array.dtype}, expected whole numbers"
            )
    return arrays


def _bundle_arrays(
    folder: Path, manifest: Document, trusted: Trust
) -> tuple[BundleArrays, Document]:
    """Read the arrays of a structure, and the provenance of graphs converted to tables."""
    named, foreign = _named(manifest), Document()
    between = np.array(manifest["command_range"], float).reshape(-1, 2)

    def shape(name: str, arrays: Arrays) -> ModeArrays | NetworkArrays:
        if f"{name}.onnx" not in named:
            return ModeArrays.from_npz(arrays)
        from softmap_edge.model.onnx import read_network

        grid = Grid.from_npz(arrays)
        found, description = read_network(folder / f"{name}.onnx", between, grid, trusted)
        if description is not None:
            foreign[name] = description
        return found

    stored = {
        file.removesuffix(".npz"): _read_archive(folder, file)
        for file in ("prior.npz", "fields.npz", *named)
        if file.endswith(".npz")
    }
    if (manifest["kind"] == "network") != ("prior.onnx" in named):
        raise BundleError(
            f"{folder.name}: a prior.onnx goes with the kind network, not with {manifest['kind']}"
        )
    if manifest["kind"] == "rod":
        prior = _learned_prior(stored["prior"], manifest["channels"])
    else:
        prior = PriorArrays.from_npz(shape("prior", stored["prior"]), stored["prior"])
    fields, residual = FieldArrays.from_npz(stored["fields"]), None
    if "residual.npz" in named or "residual.onnx" in named:
        residual = shape("residual", stored.get("residual", {}))
    return BundleArrays(prior, fields, residual), foreign


def _learned_prior(arrays: Arrays, channels: int) -> PriorArrays:
    """Read a prior that was learned from runs: a rod and its coverage."""
    from softmap_edge.model.coverage import Coverage
    from softmap_edge.model.polynomial_rod import read_rod

    rod, coverage = read_rod(arrays), Coverage.from_npz(arrays, channels)
    return PriorArrays(rod, coverage=coverage, before=NumbersBefore.from_npz(arrays))


def _model(folder: Path, manifest: Document, trusted: Trust) -> Model:
    template = Template.from_npz(folder.name, _read_archive(folder, "template.npz"))
    arrays, foreign = _bundle_arrays(folder, manifest, trusted)
    prior = arrays.prior.shape.compiled()
    rest = template.rest
    if prior.size != rest.size:
        raise BundleError(
            f"{folder.name}: template {rest.shape} and prior of {prior.size} numbers do not fit "
            "together; make the bundle again"
        )
    if prior.channels != manifest["channels"]:
        raise BundleError(
            f"{folder.name}: prior of {prior.channels} channels, but the manifest states "
            f"{manifest['channels']}; make the bundle again"
        )
    apart = foreign["prior"]["table_off_mm"] if "prior" in foreign else 0.0
    made_from = _made_from(manifest) | ({"through_onnxruntime": foreign} if foreign else {})
    model = Model(
        structure=Structure(
            prior=prior,
            fields=arrays.compiled_fields(),
            cables=arrays.fields.cables(arrays.prior.tensions()),
            second=arrays.fields.second_order(),
            rest=rest,
            triangles=template.triangles,
            tip_indices=template.tip,
            gravity_reference=np.array(manifest["gravity_reference"], float),
            command_range=np.array(manifest["command_range"], float).reshape(-1, 2),
            body=template.body,
            stiffness_known=bool(manifest.get("stiffness_known", manifest["kind"] != "rod")),
        ),
        kind="table" if "prior" in foreign else manifest["kind"],
        form_error=template.form_error,
        vertex_error_mm=float(np.hypot(manifest["held_out_error_mm"], apart)),
        error_per_g_mm=float(manifest.get("held_out_error_per_g_mm", 0.0)),
        robot=manifest["robot"],
        command_unit=str(manifest.get("command_unit", "mm")),
        input=str(manifest.get("input", "present")),
        made_from=made_from,
        output=Output.from_dict(manifest["output"]) if manifest.get("output") else None,
        handles=template.handles,
        calibration=_calibration(folder, manifest),
        safety=_safety(folder, manifest),
        arrays=replace(arrays, residual=None),
    )
    features = len(model.structure.positions)
    if model.form_error.shape != (features, 3):
        raise BundleError(
            f"{folder.name}: model-form error of shape {model.form_error.shape}, "
            f"expected ({features}, 3)"
        )
    names, params = load_chain(folder)
    nameless = [
        name for name in names if name in _loaded() and name not in manifest.get("own_effects", {})
    ]
    if nameless:
        raise BundleError(
            f"{folder.name}: its chain has '{nameless[0]}', code that its manifest does not name"
        )
    model = model.with_effects(names, params)
    if arrays.residual is None:
        return model
    return replace(model.with_residual(arrays.residual), made_from=made_from)


def _calibration(folder: Path, manifest: Document) -> Calibration | None:
    """Read the calibration of the servos, if the manifest lists it."""
    if "calibration.json" not in _named(manifest):
        return None
    try:
        found = Calibration.from_dict(read_json(folder / "calibration.json"))
    except CalibrationError as fault:
        raise BundleError(f"{folder.name}: {fault}") from None
    if len(found.b) != manifest["channels"]:
        raise BundleError(
            f"{folder.name}: calibration of {len(found.b)} servos, {manifest['channels']} channels"
        )
    return found


def _safety(folder: Path, manifest: Document) -> Safety | None:
    """Read the limits of the finger, if the manifest lists them."""
    if SAFETY not in _named(manifest):
        return None
    file, reach = folder / SAFETY, np.array(manifest["command_range"], float).reshape(-1, 2)
    if file.stat().st_size > MOST_TEXT or not len(reach):
        raise BundleError(
            f"{folder.name}: {SAFETY} of {file.stat().st_size} bytes for {len(reach)} commands; "
            "copy it again"
        )
    try:
        text = own_text(file, MOST_TEXT)
    except UnicodeDecodeError:
        raise BundleError(f"{folder.name}: {SAFETY} is not text; copy it again") from None
    read = read_safety(
        text, reach, str(manifest.get("command_unit", "mm")), f"{folder.name}: {SAFETY}"
    )
    return replace(read, edited=sha256_of(file) != manifest["sha256"][SAFETY])


def load_chain(path: str | Path) -> tuple[list[str], dict[str, float]]:
    """Read names and parameters of a bundle's effects without loading the effects."""
    folder = Path(path)
    effects = read_json(folder / "effects.json")
    names, params = effects.get("chain"), effects.get("params")
    if (
        not isinstance(names, list)
        or not all(isinstance(n, str) for n in names)
        or not isinstance(params, dict)
    ):
        raise BundleError(f"{folder.name}: effects.json needs a list `chain` and a table `params`")
    if not all(finite(v, LARGEST) for v in params.values()):
        raise BundleError(
            f"{folder.name}: effects.json: every parameter must be a number within ±{LARGEST:g}"
        )
    return names, params


def _own_hashes(manifest: Document) -> dict[str, str]:
    return {f"{name}.py": digest for name, digest in manifest.get("own_effects", {}).items()}


def _made_from(manifest: Document) -> Document:
    made = manifest.get("made_from", {})
    if made.get("learned_in") is not None:
        from softmap_edge.model.learned_in import read_learned_in

        read_learned_in(made["learned_in"])
    runs = made.get("runs", [])
    if not isinstance(runs, list) or not all(
        isinstance(run, str) and len(run) == 64 for run in runs
    ):
        raise SoftmapError("made_from: `runs` is not a list of sha256")
    parts = made.get("pieces", [])
    if not isinstance(parts, list) or not all(map(_is_piece, parts)):
        raise SoftmapError("made_from: `pieces` is not a list of sha256, first and last time")
    return dict(made)


def _is_piece(part: object) -> bool:
    """Return whether `part` is the hash of a recording with two times (s)."""
    if not isinstance(part, list) or len(part) != 3:
        return False
    return isinstance(part[0], str) and len(part[0]) == 64 and all(map(finite, part[1:]))


def _check_size(file: Path) -> None:
    """Reject a bundle file above its size limit, before reading any of it."""
    size, most = file.stat().st_size, _MOST[file.suffix]
    if size > most:
        raise BundleError(
            f"{file.parent.name}: {file.name} has {size} bytes, at most {most} are read; build or "
            "copy it again"
        )
