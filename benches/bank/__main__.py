"""Run the bank: make cases, diagnose them, write one small JSON a case, print the table. Goes on where it was stopped.

python -m benches.bank --share 0.1            a tenth of the development seeds
python -m benches.bank --seeds reporting      all, on seeds on which no threshold was set (docs/bank.md)
python -m benches.bank --table                what is there already
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from benches.bank.work import Task, code, kept, work

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # one process a core; read when NumPy is loaded, below

SIZES = {"null": 300, "single": 300, "pair": 200, "unknown": 100, "removed": 100, "untestable": 100, "rivals": 100}
SHARES = {("A", "easy"): 0.2, ("A", "real"): 0.4, ("A", "hard"): 0.2, ("B", "real"): 0.2, ("B", "clouds"): 0.15}


def tasks(seeds: str, share: float, kinds: Sequence[str], parts: Sequence[tuple[str, str]]) -> Iterator[Task]:
    """Return the cases to run, so that an early stop leaves some of each kind."""
    counts = {
        (part, kind): round(SIZES[kind] * SHARES[part] * share) for part in parts for kind in kinds if part in SHARES
    }
    for number in range(max(counts.values(), default=0)):
        for (part, kind), count in counts.items():
            if number < count:
                yield (seeds, *part, kind, number)


def rows_in(out: Path, seeds: str) -> list[dict[str, Any]]:
    """Return the finished cases of a folder."""
    return [json.loads(p.read_text(encoding="utf-8")) for p in sorted(out.glob(f"{seeds}-*.json"))]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the bank."""
    parser = argparse.ArgumentParser(prog="benches.bank", description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", choices=("development", "reporting"), default="development")
    parser.add_argument("--share", type=float, default=1.0, help="of the full sizes (1)")
    parser.add_argument("--kinds", default=",".join(SIZES), help="some of the kinds, with commas")
    parser.add_argument("--parts", default=",".join("/".join(p) for p in SHARES), help="slice/level, with commas")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--out", type=Path, default=Path("out/bank"))
    parser.add_argument("--table", action="store_true", help="only print what is there")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(argv)
    args.out.mkdir(parents=True, exist_ok=True)
    if not args.table:
        parts: list[tuple[str, str]] = [tuple(p.split("/")) for p in args.parts.split(",")]  # type: ignore[misc]
        wrong = [k for k in args.kinds.split(",") if k not in SIZES] + ["/".join(p) for p in parts if p not in SHARES]
        if wrong:
            parser.error(
                f"no '{wrong[0]}'; kinds are {', '.join(SIZES)}, parts {', '.join('/'.join(p) for p in SHARES)}"
            )
        _run(list(tasks(args.seeds, args.share, args.kinds.split(","), parts)), args.out, args.processes)
    from benches.bank.judge import parts_of, table, text

    rows = rows_in(args.out, args.seeds)
    if args.json:
        told = {part: table(mine) for part, mine in parts_of(rows).items()}
        print(json.dumps({"schema": "softmap.bank/1", "seeds": args.seeds, "cases": len(rows), "parts": told}))
    else:
        print(text(rows))
    return 0


def _run(wanted: list[Task], out: Path, processes: int) -> None:
    """Run what has no file yet, in parallel."""
    now = code()

    def finished(task: Task) -> bool:
        path = kept(task, out)
        if not path.exists():
            return False
        row = json.loads(path.read_text(encoding="utf-8"))
        return "failed" not in row and row.get("code") == now

    left = [(task, str(out), now) for task in wanted if not finished(task)]
    print(f"{len(wanted)} cases, {len(left)} to run, {processes} at a time → {out}", file=sys.stderr)
    started = time.monotonic()
    fresh = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(processes, max(len(left), 1)), mp_context=fresh) as pool:
        jobs = [pool.submit(work, job) for job in left]
        for count, job in enumerate(as_completed(jobs), start=1):
            row = job.result()
            said = row.get("failed") or f"{row['hidden']} → {row['named']} {row['verdict']}"
            print(f"[{count}/{len(left)} {time.monotonic() - started:.0f} s] {row['case']}: {said}", file=sys.stderr)


if __name__ == "__main__":
    sys.exit(main())
