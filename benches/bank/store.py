"""The files of a case: its runs, and the truth about it. Diagnosis and scoring read them.

    ROOT/<case>/truth.json    hidden laws, right answers, displacement of the finger, `made_by`
    ROOT/<case>/first.npz     the run that is diagnosed        `whole.npz` a second one, of `rivals`
    ROOT/<case>/`judge.npz`  a run of another kind  twin.npz  the same of the finger without the law
    ROOT/<case>/taught.npz    runs from which a model is learned (`taught_2.npz` of other size and
                              speed)

`made_by` is a digest of the bank's own code and of its inputs (protocols, the bundle), not of the
diagnosis. A case with the same digest is not made again. Pinned by
tests/benches/test_bank_store.py.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from softmap_edge.run.run import Run

Task = tuple[str, str, str, str, int]  # seeds, slice, level, kind, number
JUDGING = (
    "__main__.py",
    "left_out.py",
    "judge.py",
    "judge_family.py",
    "judge_learned.py",
    "work.py",
    "store.py",
)


@dataclass(frozen=True)
class Kept:
    """A case on disk."""

    folder: Path

    @cached_property
    def truth(self) -> dict[str, Any]:
        """Return the hidden laws and the right answers."""
        return dict(json.loads((self.folder / "truth.json").read_text(encoding="utf-8")))

    def run(self, name: str = "first") -> Run:
        """Read a run."""
        return Run.load(self.folder / f"{name}.npz")

    @property
    def runs(self) -> tuple[str, ...]:
        """Return the names of the stored runs."""
        return tuple(self.truth["runs"])

    @property
    def is_made(self) -> bool:
        """Return whether the case is stored."""
        return (self.folder / "truth.json").exists()

    @property
    def is_current(self) -> bool:
        """Return whether the case is stored and was made by the present code."""
        return self.is_made and bool(self.truth["made_by"] == made_by())


def name_of(task: Task) -> str:
    """Return the name of a case."""
    seeds, slice_, level, kind, number = task
    return f"{seeds}-{slice_}-{level}-{kind}-{number:04d}"


def keep(task: Task, root: Path, truth: Mapping[str, Any], runs: Mapping[str, Run]) -> Kept:
    """Write a case: its runs, then the truth, in a folder that appears at once."""
    folder, half = root / name_of(task), root / f".{name_of(task)}.{os.getpid()}"
    shutil.rmtree(half, ignore_errors=True)
    half.mkdir(parents=True)
    for name, run in runs.items():
        run.save(half / f"{name}.npz")
    head = dict(zip(("seeds", "slice", "level", "kind", "number"), task))
    told = head | {"case": name_of(task), **truth, "runs": list(runs), "made_by": made_by()}
    (half / "truth.json").write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    shutil.rmtree(folder, ignore_errors=True)
    half.rename(folder)
    return Kept(folder)


@lru_cache(maxsize=1)
def made_by() -> str:
    """Return a digest of the code that makes cases: bank without scoring, protocols, bundle."""
    import softmap_edge

    own, package = Path(__file__).parent, Path(softmap_edge.__file__).parent
    files = [path for path in sorted(own.glob("*.py")) if path.name not in JUDGING]
    files += [package / "run/protocol.py", *sorted((package / "data").rglob("*.*"))]
    digest = hashlib.sha256()
    for path in files:
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]
