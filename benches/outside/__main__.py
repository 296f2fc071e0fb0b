"""Run our diagnosis and its peers on outside data; print one table (`make outside`).

The true answers are known.

`--out FOLDER` writes outside.json and outside.md there, `--page` docs/benchmarks/outside.md;
`--only NAME` runs the sets whose name contains NAME. A missing set is skipped with its reason.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from benches.data import ROOT
from benches.outside import bouc_wen, memory, robots, tanks
from benches.outside.case import Case, error, folder
from benches.outside.ours import answer, library_laws
from benches.outside.peers import peers
from benches.outside.table import Row, document, lines, machine, page

SETS: dict[str, tuple[str, Callable[[Path], list[Case]]]] = {
    "Bouc–Wen": ("bouc_wen", lambda at: [bouc_wen.case(at)]),
    "Cascaded tanks": ("cascaded_tanks", lambda at: [tanks.case(at)]),
    "ViO-Com": ("memory", lambda at: [memory.vio(at, "vio000"), memory.vio(at, "vio090")]),
    "ARTS damper": ("memory", lambda at: [memory.arts(at)]),
    "Trunk": ("trunk", lambda at: [robots.trunk(at)]),
    "TDCR": ("tdcr", lambda at: [robots.tdcr(at)]),
    "Beam": ("beam", robots.beams),
}


def main() -> int:
    """Make the table."""
    parser = argparse.ArgumentParser(prog="python -m benches.outside", description=__doc__)
    parser.add_argument("--out", type=Path, help="folder for outside.json and outside.md")
    parser.add_argument("--page", action="store_true", help="write docs/benchmarks/outside.md")
    parser.add_argument("--only", default="", metavar="NAME", help="the sets whose name holds this")
    args = parser.parse_args()
    rows: list[Row] = []
    cases: dict[str, Case] = {}
    skipped: dict[str, str] = {}
    print(machine())
    for case in _cases(args.only, skipped):
        start = time.process_time()
        rows.append(_row(case))
        cases[case.name] = case
        spent = time.process_time() - start
        print(
            f"{case.name}: {rows[-1].answer.seconds:.0f} s of the processor for our answer, "
            f"{spent:.0f} s for the row",
            flush=True,
        )
    print(
        "\n".join(["", *lines(rows), *(f"skipped: {name}, {why}" for name, why in skipped.items())])
    )
    if args.out is not None:
        args.out.mkdir(parents=True, exist_ok=True)
        (args.out / "outside.json").write_text(document(rows, skipped), encoding="utf-8")
        (args.out / "outside.md").write_text("\n".join(lines(rows)) + "\n", encoding="utf-8")
    if args.page:
        (ROOT / "docs/benchmarks/outside.md").write_text(
            page(rows, cases, skipped), encoding="utf-8"
        )
    return 0


def _cases(only: str, skipped: dict[str, str]) -> Iterator[Case]:
    """Yield the cases of the available sets; add missing ones to `skipped`."""
    for name, (data, make) in SETS.items():
        if only.lower() not in name.lower():
            continue
        at = folder(data)
        if at is None:
            skipped[name] = f"no folder '{data}' in data/ or ../shared/data"
            continue
        yield from make(at)


def _row(case: Case) -> Row:
    """Return a row: our answer, the peers on the same model, the right law, each library law."""
    ours, model = answer(case)
    law = {} if case.law is None else case.law()
    return Row(
        name=case.name,
        unit=case.unit,
        expected=case.expected,
        law_name=case.law_name,
        answer=ours,
        peers=peers(case, model) if case.moving else {},
        law={
            name: error(case, case.held.get(name, case.fit), answer) for name, answer in law.items()
        },
        library=library_laws(case, model) if case.per_library_law else {},
    )


if __name__ == "__main__":
    raise SystemExit(main())
