"""Adapt a model to recordings: add physics first, then learn a residual of the remaining error.

    clouds ─registration─> vertices     ticks ─calibration─> commands
    diagnose ─> add the missing effects ─> learn a residual ─> validate each step alone and both
    together

A residual is a function of the command alone. It cannot represent the history of the command, and
it replaces physics only under the conditions of its runs. So it is learned last, and kept only if
it clearly lowers the error on held-out blocks. Alternatives to the added effects are reported,
because they fit these runs equally well. The calibration is fitted without the effects, so a gain,
offset or coupling found later may correct the calibration. Units: mm. Pinned by
tests/adaptation/test_adaptation.py.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from softmap_edge.adaptation.residual import ROWS, learn_residual
from softmap_edge.alignment.base_in_clouds import base_stood_off, in_base
from softmap_edge.alignment.register import register
from softmap_edge.calibration.calibration import calibrate
from softmap_edge.calibration.found import Calibrated
from softmap_edge.comparison.comparison import compare
from softmap_edge.diagnosis.diagnose import diagnose
from softmap_edge.diagnosis.document import Diagnosis
from softmap_edge.errors import CalibrationError, SoftmapError
from softmap_edge.files.atomic import Document
from softmap_edge.run.run import as_runs

if TYPE_CHECKING:
    from softmap_edge.model.model import Model
    from softmap_edge.run.run import Run

SCHEMA = "softmap.adaptation/1"
WAYS = ("as it stood", "residual alone", "physics alone", "physics, then residual")
FAULT = "measurement_fault"
# standard errors by which a residual must lower the held-out error; less is noise
SURE = 2.0


@dataclass(frozen=True, eq=False)
class Adaptation:
    """The result of an adaptation: the new `model`, and the report of each step.

    `before` is the model before the adaptation, with its calibration. `error` holds the RMS errors
    in mm of the four WAYS on data not used for learning; None if one was not tried. `fall` is the
    relative reduction of the error. `validation` is the data of these errors, `runs` the training
    data; clouds are stored as vertices. It prints as text; `to_dict()` returns
    softmap.adaptation/1.
    """

    model: Model
    before: Model
    calibration: Calibrated | None
    diagnosis: Diagnosis | None
    residual: Document
    error: dict[str, float | None]
    error_on: str
    validation: Run
    runs: list[Run]

    @property
    def added(self) -> bool:
        """Whether physics was added."""
        return self.model.chain_names != self.before.chain_names

    @property
    def last(self) -> float:
        """The error of the new model, mm RMS."""
        value = self.error[WAYS[2 * self.added + (self.model.residual is not None)]]
        assert value is not None
        return value

    @property
    def fall(self) -> float:
        """The relative reduction of the error."""
        first = self.error[WAYS[0]]
        assert first is not None
        return 1.0 - self.last / first if first > 0 else 0.0

    def to_dict(self) -> Document:
        """Return the document softmap.adaptation/1: plain numbers, strings, lists and dicts."""
        kept = self.model.residual is not None
        return {
            "schema": SCHEMA,
            "error": {
                "kind": "held-out rms",
                "unit": "mm",
                "on": self.error_on,
                "fall_share": self.fall,
                "ways": [{"way": way, "value": self.error[way]} for way in WAYS],
            },
            "calibration": None if self.calibration is None else self.calibration.to_dict(),
            "diagnosis": None if self.diagnosis is None else self.diagnosis.to_dict(),
            "residual": {"kept": kept, **self.residual},
            "effects": self.model.params,
        }

    def __str__(self) -> str:
        lines = []
        if self.calibration is not None:
            lines += [str(self.calibration), ""]
        if self.diagnosis is not None:
            lines.append(self.diagnosis.sentence)
            lines += [f"  {label:<24} {value:.6g}" for label, value in self.model.params.items()]
        lines.append(_of_residual(self.residual, self.model.residual is not None))
        alone = self.error[WAYS[2 * self.added]]
        if self.model.residual is not None and alone is not None and self.last > alone:
            lines.append("  it does not help on the validation run")
        lines += ["", f"error, mm RMS, {self.error_on}"]
        lines += [
            f"  {way:<24} {value:.3f}" for way, value in self.error.items() if value is not None
        ]
        share = f"{100 * abs(self.fall):.0f} %"
        lines.append(
            f"  {share} of the error is gone"
            if self.fall >= 0
            else f"  the error is {share} larger"
        )
        return "\n".join(
            [*lines, *(f"  look at: {text}" for text in self.residual.get("warnings", []))]
        )


def _of_residual(facts: Document, kept: bool) -> str:
    if "why" in facts:
        return f"no residual: {facts['why']}"
    every = (
        ""
        if facts["frames"] == facts["of_frames"]
        else f" of {facts['of_frames']} (complete ones, {ROWS} at most)"
    )
    line = (
        f"residual of {facts['size_mm']:.2f} mm RMS over the command, learned from "
        f"{facts['frames']} frames{every}"
    )
    return line if kept else f"{line}: left out, it does not surely lower what was held out"


def adapt(
    model: Model,
    run: Run | Sequence[Run],
    held_out: Run | None = None,
    physics: bool = True,
    progress: Callable[[str], None] | None = None,
) -> Adaptation:
    """Calibrate a model, add its missing effects, and learn a residual of the remaining error.

    Args:
        model: the model to adapt; its effects stay, and its residual is learned again.
        run: one or several recordings of the robot, with vertices, clouds or the model's markers.
            Ticks are calibrated with the first run that holds enough commands, unless the model has
            a calibration.
        held_out: a recording for validation only; without it, blocks of the runs are held out.
        physics: whether to search for missing effects; if not, the residual replaces them.
        progress: called with one line per step.

    Returns:
        Adaptation: the new model, the report of each step, and the error of each way.

    Raises:
        SoftmapError: a measurement fault, too few frames, or runs of another robot.
    """
    say = progress or (lambda line: None)
    runs = as_runs(run)
    base = model.with_residual(None)
    if not runs:
        raise SoftmapError("no run is given; an adaptation needs at least one")
    if held_out is not None and held_out.hash() in [one.hash() for one in runs]:
        raise SoftmapError(
            "the held-out run is used for learning too, so it validates nothing; give an "
            "independent run"
        )
    base, calibration = _calibrated(base, runs, say)
    shown = [_shown(base, one, say) for one in runs]
    found = _missing(base, shown, say) if physics else None
    better = base if found is None or found.model is None else found.model
    say("learning the unexplained error as a smooth field of the command")
    added = better.chain_names != base.chain_names
    rest, residual = _rest(better, shown, added)
    kept = rest is not None and residual["gain_in_se"] > SURE
    if held_out is None:
        validation, error, on = shown[0], _on_blocks(found, residual), _blocks(found)
    else:
        validation, on = (
            _shown(base, held_out, say),
            "a run that taught nothing, points that were seen",
        )
        alone = rest if found is None else _rest(base, shown, True)[0]
        ways = [base, alone, *([None, None] if found is None else [better, rest])]
        error = {
            way: None if m is None else compare(m, validation).error["rms_mm"]
            for way, m in zip(WAYS, ways)
        }
    model = rest if kept and rest is not None else better
    return Adaptation(model, base, calibration, found, residual, error, on, validation, shown)


def _rest(model: Model, runs: Sequence[Run], spare: bool) -> tuple[Model | None, Document]:
    """Return the model with a residual and its report.

    If the runs do not support a residual and none is required, return None and the reason.
    """
    try:
        return learn_residual(model, runs)
    except SoftmapError as fault:
        if not spare:
            raise
        return None, {"why": str(fault)}


def _shown(model: Model, run: Run, say: Callable[[str], None]) -> Run:
    """Convert a run of clouds to template vertices in the base frame; return others unchanged."""
    if run.points is None:
        return run
    run, off = in_base(run, model)
    if off is not None:
        say(base_stood_off(off.pose))
    say(f"laying the template onto {run.frames} clouds")
    return register(model, run).run(run)


def _calibrated(
    model: Model, runs: Sequence[Run], say: Callable[[str], None]
) -> tuple[Model, Calibrated | None]:
    """Calibrate the model with the first sufficient run, if needed.

    A calibration is needed if runs have ticks and the model has none.
    """
    ticks = [run for run in runs if run.ticks is not None or run.present_ticks is not None]
    if model.calibration is not None or not any(run.command is None for run in ticks):
        return model, None
    faults = []
    for run in ticks:
        try:
            say("finding what the ticks are in commands")
            found = calibrate(model, run)
            return found.model, found
        except CalibrationError as fault:
            faults.append(fault)
    raise faults[0]


def _missing(model: Model, runs: Sequence[Run], say: Callable[[str], None]) -> Diagnosis:
    say("looking for what the model lacks")
    found = diagnose(model, runs, progress=lambda line: say(f"  {line}"))
    if found.verdict == FAULT and not found.effects and not found.faults:
        raise SoftmapError(
            f"nothing is learned from a measurement that is at fault. {found.sentence}"
        )
    return found


def _blocks(found: Diagnosis | None) -> str:
    if found is None:
        return "blocks of the runs that were left out, points that were seen"
    return (
        "blocks of the runs that were left out, middles of sections or markers; a residual is a "
        "polynomial there"
    )


def _on_blocks(found: Diagnosis | None, residual: Document) -> dict[str, float | None]:
    """Return the errors of the ways on held-out blocks.

    They come from the diagnosis or from the residual's cross-validation.
    """
    if found is None:
        both: list[float | None] = [
            residual["before_rms_mm"],
            residual["after_held_out_rms_mm"],
            None,
            None,
        ]
        return dict(zip(WAYS, both))
    error = found.to_dict()["error"]
    physics = error["ladder"][-1]["value"] if error["ladder"] else error["model"]
    return dict(
        zip(
            WAYS, (error["model"], error["static_residual"], physics, error["with_static_residual"])
        )
    )
