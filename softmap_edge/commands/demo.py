"""The command `demo`: measure a finger with hidden effects, diagnose it, add effects, validate.

A `Trial` contains the steps without printing; the hidden-effect tests run the same one.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from softmap_edge.commands.output import next_command
from softmap_edge.commands.progress import Ticker
from softmap_edge.comparison.comparison import Comparison, compare
from softmap_edge.comparison.series import series
from softmap_edge.diagnosis.diagnose import diagnose
from softmap_edge.diagnosis.document import Diagnosis
from softmap_edge.errors import SoftmapError
from softmap_edge.files.atomic import Document, write_atomically
from softmap_edge.files.numbers import fall
from softmap_edge.model.bundle import builtin_model, save_bundle
from softmap_edge.model.model import Model
from softmap_edge.report.html import write_html
from softmap_edge.report.pages import pictures_missing
from softmap_edge.robot.emulated.named_laws import check_hidden
from softmap_edge.run.protocol import Protocol, other_protocol, standard_protocol
from softmap_edge.run.run import Run
from softmap_edge.synthetic.finger import WATCH, Truth, hide, stretch, surprise

SCHEMA = "softmap.demo/1"
FIRST_SEED = 1
FLOOR_KIND = "the same finger with nothing hidden"


@dataclass(frozen=True)
class Trial:
    """One case with hidden effects, from measurement to validation.

    Errors are held out: RMS mm over all vertices of a run that took no part in the fit.
    """

    truth: Truth
    model: Model
    run: Run
    other: Run
    fitted: Comparison
    diagnosis: Diagnosis
    before: Comparison
    after: Comparison
    floor_mm: float

    @property
    def before_mm(self) -> float:
        """Error of the original model."""
        return self.before.error["rms_mm"]

    @property
    def after_mm(self) -> float:
        """Error of the model with the effects that the diagnosis added."""
        return self.after.error["rms_mm"]

    @property
    def fall(self) -> float | None:
        """Share of the removable error that was removed: (before − after) / (before − floor)."""
        return fall(self.before_mm, self.after_mm, self.floor_mm)

    def to_dict(self) -> Document:
        """Return the document softmap.demo/1."""
        share = self.fall if self.truth.hidden else None
        return {
            "schema": SCHEMA,
            "seed": self.truth.seed,
            "hidden": [secret.to_dict() for secret in self.truth.hidden],
            "diagnosis": self.diagnosis.to_dict(),
            "before_mm": self.before_mm,
            "after_mm": self.after_mm,
            "floor_mm": self.floor_mm,
            "floor_kind": FLOOR_KIND,
            "fall": share,
            "frames": {"fitted": self.fitted.frames, "held_out": self.before.frames},
            "other_finger": {"modulus_factor": self.truth.modulus, "mesh": "another resolution"},
        }


def trial(
    model: Model,
    truth: Truth,
    say: Callable[[str], None] = lambda text: None,
    judge: Protocol | None = None,
    protocol: Protocol | None = None,
) -> Trial:
    """Measure `truth`, diagnose, and validate on a run of another kind.

    Args:
        model: model of the first finger
        truth: the second finger
        say: receives lines on progress
        judge: the validation run (`other_protocol`); the diagnosis never receives it
        protocol: the run that is diagnosed (`standard_protocol`)

    Returns:
        The runs, and the findings.
    """
    protocol = protocol or standard_protocol(model.channels)
    judge = judge or other_protocol(model.channels)
    say(
        f"Measuring the second finger: {protocol.frames} frames in {protocol.t[-1] / 60:.0f} "
        "minutes of finger time …"
    )
    run = truth.measure(protocol)
    fitted = compare(model, run)
    say(
        f"  The model is off by {fitted.error['rms_mm']:.2f} mm RMS (nothing fitted), at the tip "
        f"by {fitted.error['tip_rms_mm']:.2f} mm RMS."
    )
    say("Looking for what the model lacks …")
    diagnosis = diagnose(model, run, progress=lambda line: say(f"  {line}"))
    say(f"  {diagnosis.to_dict()['sentence']}")
    say(
        f"Measuring a run of another kind ({judge.frames} frames of circles, spirals and random "
        "moves) for validation …"
    )
    with stretch(0.0, 0.5):
        other = truth.measure(judge, seed=1)
    with stretch(0.5, 1.0):
        floor = compare(model, truth.twin().measure(judge, seed=1)).error["rms_mm"]
    assert diagnosis.model is not None
    before, after = compare(model, other), compare(diagnosis.model, other)
    return Trial(truth, model, run, other, fitted, diagnosis, before, after, floor)


@dataclass(frozen=True)
class DemoOptions:
    """Options of `softmap demo`, as its parser declares them."""

    hide: list[str]
    seed: int
    out: str
    json: bool


def demo_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of `demo`."""
    parser.add_argument(
        "--hide",
        nargs="+",
        default=["random"],
        metavar="NAME,NAME",
        help="hidden effects of the second finger: names, 'nothing', or 'random' (default)",
    )
    parser.add_argument(
        "--seed",
        type=int,
        default=FIRST_SEED,
        help=f"random seed of the finger and the strengths ({FIRST_SEED})",
    )
    parser.add_argument(
        "--out", default="demo", help="folder for the runs, the bundle and the report (demo)"
    )


def demo(args: DemoOptions) -> int:
    """Run the complete workflow on a simulated finger with hidden effects."""
    started = time.monotonic()
    ticker = Ticker((lambda text: None) if args.json else (lambda text: print(text, flush=True)))
    say, before = ticker.say, WATCH.set(ticker)
    try:
        return _demonstrate(args, say, started)
    finally:
        WATCH.reset(before)


def _demonstrate(args: DemoOptions, say: Callable[[str], None], started: float) -> int:
    names = _hidden_names(args.hide, args.seed)
    Path(args.out).mkdir(parents=True, exist_ok=True)  # fail before the work, not after it
    say("Taking the model of the built-in finger, made from a simulated sweep.")
    model = builtin_model()
    say("Making a second finger: another mesh, another batch of silicone, and a hidden effect …")
    story = trial(model, hide(names, args.seed), say)
    say(_table(story))
    files = _write(story, Path(args.out))
    document = story.to_dict() | {"files": files, "seconds": round(time.monotonic() - started, 1)}
    if args.json:
        print(json.dumps(document))
    else:
        print("\n".join(_reveal(story, files, document["seconds"])))
    return 0


def _hidden_names(words: Sequence[str], seed: int) -> list[str]:
    text = ",".join(words)
    names = [] if text in ("nothing", "random") else [name.strip() for name in text.split(",")]
    try:
        check_hidden(names, seed)
    except SoftmapError as fault:
        raise SoftmapError(f"{fault}; --hide takes 'nothing' and 'random' as well") from None
    return surprise(seed) if text == "random" else names


def _write(story: Trial, folder: Path) -> dict[str, str]:
    """Write runs, diagnosis, completed bundle and report; return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    files = {
        "run": folder / "run.npz",
        "held_out_run": folder / "other_run.npz",
        "diagnosis": folder / "diagnosis.json",
        "bundle": folder / "finger2",
    }
    story.run.save(files["run"])
    story.other.save(files["held_out_run"])
    write_atomically(files["diagnosis"], json.dumps(story.diagnosis.to_dict(), indent=1) + "\n")
    assert story.diagnosis.model is not None
    save_bundle(story.diagnosis.model, files["bundle"])
    files["report"] = write_html(
        folder / "report.html",
        [story.before, story.after],
        story.diagnosis.to_dict(),
        series(story.other, story.model, story.diagnosis.model),
        (story.floor_mm, FLOOR_KIND),
    )
    return {name: str(path) for name, path in files.items()}


def _table(story: Trial) -> str:
    """Return the errors before and after on the run of another kind, where they are largest."""
    rows = [("all vertices", story.before_mm, story.after_mm)]
    rows.append(("tip", story.before.error["tip_rms_mm"], story.after.error["tip_rms_mm"]))
    for name in ("direction", "orientation"):
        known = {row.label: row.rms_mm for row in story.after.where.get(name, [])}
        rows += [
            (row.label, row.rms_mm, known.get(row.label, row.rms_mm))
            for row in story.before.where.get(name, [])
        ]
    lines = [f"  {'mm RMS, held out':<32} before   after"]
    return "\n".join(
        ["", *lines, *(f"  {label:<32} {old:6.2f}  {new:6.2f}" for label, old, new in rows)]
    )


def _reveal(story: Trial, files: dict[str, str], seconds: float) -> Sequence[str]:
    lines = [
        "",
        f"Held-out error {story.before_mm:.2f} → {story.after_mm:.2f} mm RMS (floor "
        f"{story.floor_mm:.2f} mm:",
    ]
    lines[-1] += f" {FLOOR_KIND})."
    if story.truth.hidden and story.fall is not None:
        lines.append(
            f"{100 * story.fall:.0f} % of the removable error is gone, on a run that was never "
            "fitted."
        )
    found = story.diagnosis.to_dict()["effects"]
    lines += [f"Found:  {effect['name']} ({_values(effect)})" for effect in found] or [
        "Found:  nothing"
    ]
    if not story.truth.hidden:
        lines.append("Hidden: nothing (another mesh, another modulus and camera noise only)")
    for secret in story.truth.hidden:
        numbers = ", ".join(
            f"{key} {_plain(value)}" for key, value in secret.law.params().items() if key != "seed"
        )
        lines.append(
            f"Hidden: {secret.name} ({numbers}); it moves the finger by "
            f"{secret.displacement_mm:.1f} mm RMS"
        )
    install = pictures_missing()
    lines.append(
        f"Open {files['report']}"
        + (f" (for pictures in it: {install}, then again)" if install else "")
    )
    lines.append(f"({seconds:.0f} s)")
    lines.append(next_command("check", files["run"]))
    return lines


def _values(effect: Document) -> str:
    """Return the fitted values of an effect in the library's form of its law."""
    rows = {label.split(".", 1)[1]: row for label, row in effect["params"].items()}
    units = {name: "" if row["unit"] == "1" else f" {row['unit']}" for name, row in rows.items()}
    return ", ".join(f"{name} {row['value']:.3g}{units[name]}" for name, row in rows.items())


def _plain(value: float | list[float]) -> str:
    if isinstance(value, list):
        return "[" + ", ".join(f"{x:.3g}" for x in value) + "]"
    return f"{value:.3g}"
