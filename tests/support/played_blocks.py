"""A model, its limits, and blocks of commands played on it."""

from dataclasses import replace

import numpy as np

from softmap_edge import Run, builtin_model
from softmap_edge.diagnosis.document import Diagnosis
from softmap_edge.run.protocol import Limits

MODEL = builtin_model()


LIMITS = Limits.of(MODEL.command_range)


def played(made, hidden=None, seed=0):
    """A plan as the model with `hidden` parameters shows it to a camera."""
    names = list(dict.fromkeys(label.split(".")[0] for label in hidden or {}))
    blank = Run(
        t=made.t,
        command=made.command,
        t_seen=made.t_seen,
        gravity=made.gravity,
        load=made.load,
        block=made.block,
        robot=MODEL.robot,
        vertices=np.repeat(MODEL.rest[None], made.frames, axis=0),
    )
    seen = MODEL.with_effects(names, hidden or {}).predict(blank)
    return replace(
        blank, vertices=seen + 0.25 * np.random.default_rng(seed).normal(size=seen.shape)
    )


def document(**changed):
    """A diagnosis that names nothing."""
    empty = {name: [] for name in ("effects", "faults", "alternatives", "not_testable", "next")}
    empty |= {name: {} for name in ("where", "error", "unexplained", "made_from")}
    return Diagnosis.from_dict(
        {"schema": "softmap.diagnosis/2", "verdict": "nothing", "sentence": ""} | empty | changed
    )
