"""Compiled shapes from a bundle's arrays: prior, fields, response of cables, and second order.

The name of an array gives its role: `axis0…` or `nodes`, `coefficients`, `mean` and `modes` of a
family, or `onnx`; `coefficients_NAME` of a field, `tension_0…` among them; `pull`, `stiffness` and
`stretch` of cables; `second_…`. Arrays may be whole numbers of steps (`npz.unpacked`). Units: those
of `_core.FIELDS`. Pinned by tests/model/test_bundle.py.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from softmap_edge import _core
from softmap_edge.files.atomic import Document
from softmap_edge.files.npz import unpacked

# what the fields of one bundle have in common besides their axes
_SHARED = ("modes", "nodes", "scale", "power")
_TENSION = "tension_"  # what the field of a tendon is called, before its number


def family_from(
    arrays: Mapping[str, NDArray[np.generic]],
) -> _core.Table | _core.Scattered | _core.Network:
    """Return the compiled shape family of a bundle's arrays.

    These are `coefficients`, `mean` and `modes` over `axis0…` or over scattered `nodes`; or the
    network of `onnx`, the bytes of its file.
    """
    if "onnx" in arrays:
        return _core.Network(np.asarray(arrays["onnx"], np.uint8).tobytes())
    arrays = unpacked(arrays)
    mean, modes, coefficients = (
        np.asarray(arrays[name], np.float64) for name in ("mean", "modes", "coefficients")
    )
    if "nodes" in arrays:
        nodes, scale = (np.asarray(arrays[name], np.float64) for name in ("nodes", "scale"))
        return _core.Scattered(nodes, scale, int(arrays["power"].item()), coefficients, mean, modes)
    axes: list[NDArray[np.float64]] = []
    while f"axis{len(axes)}" in arrays:
        axes.append(np.asarray(arrays[f"axis{len(axes)}"], np.float64))
    return _core.Table(axes, coefficients, mean, modes)


def table_from(arrays: Mapping[str, NDArray[np.generic]]) -> _core.Table:
    """Return the compiled table stored in `arrays` as `axis0…`, `coefficients`, `mean`, `modes`."""
    family = family_from({name: array for name, array in arrays.items() if name != "nodes"})
    assert isinstance(family, _core.Table)
    return family


def fields_from(arrays: Mapping[str, NDArray[np.generic]]) -> Document:
    """Return the compiled fields of a bundle.

    They are stored as `coefficients_NAME` over shared `axis0…` or `nodes`, and `modes`.
    """
    arrays = unpacked(arrays)
    shared = {
        key: value for key, value in arrays.items() if key.startswith("axis") or key in _SHARED
    }
    names = [key.removeprefix("coefficients_") for key in arrays if key.startswith("coefficients_")]
    size = shared["modes"].shape[1] if names else 0
    return {
        name: family_from(
            {**shared, "coefficients": arrays[f"coefficients_{name}"], "mean": np.zeros(size)}
        )
        for name in sorted(names)
        if not name.startswith(_TENSION)
    }


def cables_from(
    prior: Mapping[str, NDArray[np.generic]], fields: Mapping[str, NDArray[np.generic]]
) -> _core.Cables | None:
    """Return the cables of a bundle.

    They are stored as `pull` alongside the prior, and as `stiffness`, `stretch` and tension fields.

    None for a prior without them: its fields answer loads alone.
    """
    if "stiffness" not in fields:
        return None
    prior, fields = unpacked(prior), unpacked(fields)
    shared = {
        key: value for key, value in fields.items() if key.startswith("axis") or key == "modes"
    }
    still = np.zeros(shared["modes"].shape[1])
    names = [f"coefficients_{_TENSION}{i}" for i in range(fields["stiffness"].size)]
    return _core.Cables(
        np.asarray(fields["stiffness"], np.float64),
        plain_table(prior, "pull"),
        plain_table({**fields, "stretch": _stretch(fields)}, "stretch"),
        [table_from({**shared, "coefficients": fields[name], "mean": still}) for name in names],
    )


def _stretch(fields: Mapping[str, NDArray[np.generic]]) -> NDArray[np.float64]:
    """Return the stretch (S, T·(F + T)) of each tendon for each of `_core.FIELDS` and each tension.

    Zero where a bundle has no such field.
    """
    tendons, loads = fields["stiffness"].size, len(_core.LOADS)
    stored = np.asarray(fields["stretch"], np.float64).reshape(
        len(fields["stretch"]), tendons, loads + tendons
    )
    full = np.zeros((len(stored), tendons, len(_core.FIELDS) + tendons))
    full[..., :loads], full[..., len(_core.FIELDS) :] = stored[..., :loads], stored[..., loads:]
    for f, name in enumerate(_core.FIELDS):
        if f"stretch_{name}" in fields:
            full[..., f] = fields[f"stretch_{name}"]
    return full.reshape(len(full), -1)


def second_from(fields: Mapping[str, NDArray[np.generic]]) -> _core.Second | None:
    """Return the second-order response to loads and moduli, stored as `second_…`.

    It has weights (S, P, m), stretch (S, P, T) and growth (S, L + T) over its own axes, and modes
    (m, M) made of the `modes` of the fields. It is None for a bundle without it. Those of pairs
    with a modulus, `second_moduli_…`, may be absent.
    """
    if "second_weights" not in fields:
        return None
    unpacked_fields = unpacked(fields)
    numbers = {
        name.removeprefix("second_"): np.asarray(array, np.float64)
        for name, array in unpacked_fields.items()
        if name.startswith("second_")
    }
    modes = numbers["modes"] @ np.asarray(unpacked_fields["modes"], np.float64)
    axes = [numbers[f"axis{c}"] for c in range(sum(name.startswith("axis") for name in numbers))]

    def rows(of: str) -> NDArray[np.float64]:
        weights, stretch, growth = (numbers[of + what] for what in ("weights", "stretch", "growth"))
        pairs = np.concatenate([weights, stretch], axis=2).reshape(len(growth), -1)
        return np.concatenate([pairs, growth], axis=1)

    moduli = rows("moduli_") if "moduli_weights" in numbers else None
    return _core.Second(axes, rows(""), numbers["stretch"].shape[2], modes, moduli)


def pairs_of(
    loads: int, moduli: int, tensions: int
) -> dict[str, tuple[list[tuple[int, int]], list[int]]]:
    """Return the pairs of causes as `_core.Second` takes them, and whose growth goes with them.

    Causes are loads, then moduli, then tensions. The pairs are those among loads and tensions, then
    those of each modulus with all of these and with moduli from itself on.
    """
    plain = [*range(loads), *range(loads + moduli, loads + moduli + tensions)]
    own = list(range(loads, loads + moduli))
    return {
        "second": ([(k, l) for i, k in enumerate(plain) for l in plain[i:]], plain),
        "second_moduli": ([(k, l) for i, k in enumerate(own) for l in plain + own[i:]], own),
    }


def plain_table(arrays: Mapping[str, NDArray[np.generic]], name: str) -> _core.Table:
    """Return the table of the numbers (S, n) called `name` over `axis0…`, each its own mode."""
    arrays = unpacked(arrays)
    axes = {key: value for key, value in arrays.items() if key.startswith("axis")}
    width = arrays[name].shape[1]
    return table_from(
        {**axes, "coefficients": arrays[name], "mean": np.zeros(width), "modes": np.eye(width)}
    )
