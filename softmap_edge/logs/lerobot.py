"""Read LeRobot metadata: `meta/info.json` of a dataset, and the calibration of an arm.

A dataset holds many episodes of one robot in Parquet files; its info names the elements of `action`
and `observation.state`. A calibration lists the raw tick range of each motor. It holds no length
and cannot calibrate a tendon, so it is explained, not used. Reference: LeRobot's dataset format
v2.1 and v3.0, `MotorCalibration`.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from pathlib import Path

from softmap_edge.errors import RunError, brief
from softmap_edge.files.atomic import Document, finite, own_text
from softmap_edge.files.printable import listed

EITHER_UNIT = (
    "whether the dataset holds degrees or LeRobot's values from -100 to 100 (a gripper's from 0 "
    "to 100); the arm's calibration turns the latter into ticks (docs/reference/mapping.md)"
)
INFO = Path("meta") / "info.json"
_SIZE = 2**24  # bytes of an info file
_MOST = 4096  # elements of one feature
_KEYS = {"id", "homing_offset", "range_min", "range_max"}
_SHOWN = 4  # motors that a message lists


@dataclass(frozen=True)
class Info:
    """The metadata of a dataset.

    Attributes:
        version: the format version, such as `v3.0`.
        fps: rows per second, if given.
        names: the names of the elements of each feature.
    """

    version: str
    fps: float | None
    names: dict[str, list[str]] = field(default_factory=dict)


def is_dataset(folder: Path) -> bool:
    """Return whether a folder is a LeRobot dataset."""
    return (folder / INFO).is_file()


def dataset_files(folder: Path) -> list[Path]:
    """Return the Parquet files of a dataset in order of their names.

    Raises:
        RunError: the dataset has none.
    """
    files = sorted((folder / "data").glob("chunk-*/*.parquet"))
    if not files:
        raise RunError(
            f"{folder}: is a LeRobot dataset without data/chunk-*/*.parquet; download its data as "
            "well"
        )
    return files


def info_near(path: Path) -> Info | None:
    """Return the info of a Parquet file's dataset, two folders above data/chunk-000/.

    Raises:
        RunError: the info exists but cannot be read.
    """
    place = path.absolute().parents
    folder = place[2] if len(place) > 2 else place[0]
    return read_info(folder / INFO) if is_dataset(folder) else None


def read_info(path: Path) -> Info:
    """Read the info of a dataset.

    Raises:
        RunError: it is too large or damaged.
    """
    try:
        if path.stat().st_size > _SIZE:
            raise RunError(
                f"{path}: {path.stat().st_size} bytes, at most {_SIZE} are read; download it again"
            )
        document = json.loads(own_text(path, _SIZE))
    except OSError as cause:
        raise RunError(
            f"{path}: cannot be read ({cause.strerror or cause}); download it again"
        ) from cause
    except (ValueError, RecursionError) as fault:
        raise RunError(f"{path}: is not JSON ({brief(fault)}); download it again") from None
    features = document.get("features") if isinstance(document, dict) else None
    if not isinstance(features, dict):
        raise RunError(f"{path}: has no `features`; expected the info of a LeRobot dataset")
    fps = document.get("fps")
    known = finite(fps) and 1e-3 <= fps <= 1e5
    names = {
        name: found
        for name, feature in list(features.items())[:_MOST]
        if (found := _names(feature))
    }
    return Info(
        str(document.get("codebase_version", ""))[:20], float(fps) if known else None, names
    )


def _names(feature: object) -> list[str]:
    """Return the names of a feature's elements: a list, or one in a table (`{"motors": […]}`)."""
    names = feature.get("names") if isinstance(feature, dict) else None
    if isinstance(names, dict):
        lists = [value for value in names.values() if isinstance(value, list)]
        names = lists[0] if len(lists) == 1 else None
    if not isinstance(names, list) or not 0 < len(names) <= _MOST:
        return []
    return [name[:80] for name in names] if all(isinstance(name, str) for name in names) else []


# --- calibration ---------------------------------------------------------------------------
def explained(document: object) -> str | None:
    """Return an explanation of a LeRobot calibration and its use; None for other documents."""
    if not isinstance(document, dict) or not 0 < len(document) <= _MOST:
        return None
    motors = {
        str(name): motor
        for name, motor in document.items()
        if isinstance(motor, dict) and motor.keys() >= _KEYS
    }
    if len(motors) != len(document):
        return None
    each = listed((_motor(name, motor) for name, motor in motors.items()), _SHOWN)
    first = next(iter(motors.values()))
    return (
        f"is the calibration of a LeRobot arm, no log: {each}. It holds the ticks that each motor "
        "may take, not how many mm a tick moves. Import the dataset itself; values from -100 to "
        f"100 become ticks in the mapping by ticks = {{ columns = [ONE], {_line(first)} }} of "
        "each motor, and `softmap model calibrate` finds their mm"
    )


def _motor(name: str, motor: Document) -> str:
    return (
        f"{name[:20]} (id {_short(motor['id'])}, {_short(motor['range_min'])} to "
        f"{_short(motor['range_max'])})"
    )


def _short(value: object) -> str:
    return f"{value:g}" if isinstance(value, int | float) and abs(value) < 1e9 else "?"


def _line(motor: Document) -> str:
    """Return scale and offset of one motor's ticks in the notation of a mapping."""
    low, high = motor["range_min"], motor["range_max"]
    if not all(isinstance(x, int | float) and abs(x) < 1e9 for x in (low, high)):
        return "scale = (range_max - range_min) / 200, offset = (range_max + range_min) / 2"
    sign = -1 if motor.get("drive_mode") else 1
    return f"scale = {sign * (high - low) / 200:g}, offset = {(high + low) / 2:g}"
