"""Run the bank: make cases once, diagnose and score them, print the table.

Each case gives one small JSON.

python -m benches.bank --share 0.1            a tenth of the development seeds
python -m benches.bank --seeds reporting      all, on seeds on which no threshold was set
                                              (docs/benchmarks/bank.md)
python -m benches.bank --make  only make the cases; `--judge`: only score those that are made
python -m benches.bank --table                print the table of the rows that exist
python -m benches.bank --set FORM=0.1 --out OTHER       score with another constant of decision.py,
                                                        for the next line
python -m benches.bank --left-out OTHER,THIRD           each slice with the constants that are best
                                                        on the other slices

An interrupted run continues where it stopped. After a change of the diagnosis only the diagnosis is
repeated.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from benches.bank.store import Kept, Task, name_of
from benches.bank.work import Job, code, decided, judge, kept, make, work

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "RAYON_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # one process a core; read when NumPy is loaded, below

Part = tuple[str, str]  # slice, level

SIZES = {
    "null": 300,
    "single": 300,
    "pair": 200,
    "unknown": 100,
    "removed": 100,
    "untestable": 100,
    "rivals": 100,
}
SHARES: dict[Part, float] = {
    ("A", "easy"): 0.2,
    ("A", "real"): 0.4,
    ("A", "hard"): 0.2,
    ("B", "real"): 0.2,
    ("B", "clouds"): 0.15,
}
SLICES: dict[Part, dict[str, int]] = {
    ("shop", "floor"): {"null": 100, "single": 150, "pair": 60, "unknown": 60},
    ("odd", "maps"): {"unknown": 60},
    ("odd", "real"): {"null": 100, "single": 150, "pair": 60, "unknown": 60, "trap": 60},
    ("learned", "one"): {"null": 50, "single": 75, "pair": 30, "unknown": 30},
    ("learned", "two"): {"null": 50, "single": 75, "pair": 30, "unknown": 30},
}
PARTS: tuple[Part, ...] = (*SHARES, *SLICES)
KINDS = (*SIZES, "trap")


def size(part: Part, kind: str, share: float) -> int:
    """Return the number of cases of a kind in a part of the bank."""
    full = SLICES[part].get(kind, 0) if part in SLICES else SIZES.get(kind, 0) * SHARES[part]
    return round(full * share)


def tasks(seeds: str, share: float, kinds: Sequence[str], parts: Sequence[Part]) -> Iterator[Task]:
    """Return the cases to run, so that an early stop leaves some of each kind."""
    counts = {(part, kind): size(part, kind, share) for part in parts for kind in kinds}
    for number in range(max(counts.values(), default=0)):
        for (part, kind), count in counts.items():
            if number < count:
                yield (seeds, *part, kind, number)


def rows_in(out: Path, seeds: str) -> list[dict[str, Any]]:
    """Return the finished cases of a folder."""
    return [json.loads(p.read_text(encoding="utf-8")) for p in sorted(out.glob(f"{seeds}-*.json"))]


def main(argv: Sequence[str] | None = None) -> int:
    """Run the bank."""
    parser = argparse.ArgumentParser(prog="benches.bank", description=__doc__.split("\n\n")[0])
    parser.add_argument("--seeds", choices=("development", "reporting"), default="development")
    parser.add_argument("--share", type=float, default=1.0, help="of the full sizes (1)")
    parser.add_argument("--kinds", default=",".join(KINDS), help="some of the kinds, with commas")
    parser.add_argument(
        "--parts", default=",".join("/".join(p) for p in PARTS), help="slice/level, with commas"
    )
    parser.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="processes at a time")
    parser.add_argument(
        "--out", type=Path, default=Path("out/bank"), help="folder of the scored cases"
    )
    parser.add_argument("--cases", type=Path, help="folder of the cases that were made (OUT/cases)")
    step = parser.add_mutually_exclusive_group()
    step.add_argument("--make", action="store_true", help="only make the cases")
    step.add_argument(
        "--judge", action="store_true", help="only diagnose and score cases that are made"
    )
    step.add_argument("--table", action="store_true", help="only print the table")
    step.add_argument(
        "--left-out", metavar="OUTS", help="folders of rows with other constants, with commas"
    )
    parser.add_argument(
        "--set",
        default="",
        metavar="NAME=VALUE",
        help="other constants of decision.py, with commas",
    )
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args(argv)
    parts, kinds = [tuple(p.split("/")) for p in args.parts.split(",")], args.kinds.split(",")
    wrong = [k for k in kinds if k not in KINDS] + ["/".join(p) for p in parts if p not in PARTS]
    if wrong:
        parser.error(
            f"no '{wrong[0]}'; kinds are {', '.join(KINDS)}, parts "
            f"{', '.join('/'.join(p) for p in PARTS)}"
        )
    try:
        decided(args.set)
    except ValueError as error:
        parser.error(str(error))
    if args.left_out:
        from benches.bank import left_out

        outs = [args.out, *map(Path, args.left_out.split(","))]
        every = [rows_in(out, args.seeds) for out in outs]
        if not all(every):
            parser.error(
                f"no rows of {args.seeds} seeds in {outs[every.index([])]}; score cases with "
                "--out there first"
            )
        print(left_out.text({set_of(rows): rows for rows in every}))
        return 0
    cases = args.cases or args.out / "cases"
    args.out.mkdir(parents=True, exist_ok=True)
    wanted = list(tasks(args.seeds, args.share, kinds, parts))  # type: ignore[arg-type]
    if args.make:
        _make(wanted, cases, args.jobs)
        return 0
    if not args.table:
        _judge(wanted, cases, args.out, args.jobs, args.judge, args.set)
    from benches.bank.judge import parts_of, table, text

    rows = rows_in(args.out, args.seeds)
    if args.json:
        told = {part: table(mine) for part, mine in parts_of(rows).items()}
        print(
            json.dumps(
                {"schema": "softmap.bank/2", "seeds": args.seeds, "cases": len(rows), "parts": told}
            )
        )
    else:
        print(text(rows))
    return 0


def _make(wanted: list[Task], cases: Path, jobs: int) -> None:
    """Make the missing cases."""
    left = [
        (task, str(cases), "", "") for task in wanted if not Kept(cases / name_of(task)).is_current
    ]
    print(f"{len(wanted)} cases, {len(left)} to make, {jobs} at a time → {cases}", file=sys.stderr)
    _each(make, left, jobs, lambda row: f"{row['hidden']} {row['seconds']} s")


def set_of(rows: Sequence[dict[str, Any]]) -> str:
    """Return the constants with which rows were scored."""
    return str(rows[0]["code"]).partition(" ")[2] or "shipped"


def _judge(
    wanted: list[Task], cases: Path, out: Path, jobs: int, only_made: bool, constants: str
) -> None:
    """Diagnose and score the cases without a row of this code.

    Make missing cases first, or nothing else with `only_made`.
    """
    now = f"{code()} {constants}".strip()

    def finished(task: Task) -> bool:
        path = kept(task, out)
        if not path.exists():
            return False
        row = json.loads(path.read_text(encoding="utf-8"))
        case = Kept(cases / name_of(task))
        there = case.is_made and (only_made or case.is_current)
        return (
            there
            and "failed" not in row
            and row["code"] == now
            and row["made_by"] == case.truth["made_by"]
        )

    wanted = [task for task in wanted if not only_made or Kept(cases / name_of(task)).is_made]
    left = [(task, str(cases), str(out), now) for task in wanted if not finished(task)]
    print(f"{len(wanted)} cases, {len(left)} to score, {jobs} at a time → {out}", file=sys.stderr)
    what, said = (
        judge if only_made else work,
        lambda row: f"{row['hidden']} → {row['named']} {row['verdict']}",
    )
    _each(what, left, jobs, said, constants)


def _each(
    what: Callable[[Job], dict[str, Any]],
    left: list[Job],
    jobs: int,
    said: Callable[[dict[str, Any]], str],
    constants: str = "",
) -> None:
    """Run `what` on jobs, in parallel, with a line for each."""
    started = time.monotonic()
    fresh = multiprocessing.get_context("spawn")
    count = max(1, min(jobs, len(left)))
    with ProcessPoolExecutor(
        count, mp_context=fresh, initializer=decided, initargs=(constants,)
    ) as pool:
        running = [pool.submit(what, job) for job in left]
        for count, job in enumerate(as_completed(running), start=1):
            row = job.result()
            line = row.get("failed") or said(row)
            print(
                f"[{count}/{len(left)} {time.monotonic() - started:.0f} s] {row['case']}: {line}",
                file=sys.stderr,
            )


if __name__ == "__main__":
    sys.exit(main())
