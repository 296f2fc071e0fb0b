"""JSON schemas of the most used documents; `docs/make_reference.py` writes them.

That of a diagnosis is made from its dataclasses. A document may hold further keys: a reader ignores
those that it does not know. Documents of real runs are checked against the schemas by
tests/project/test_reference.py.
"""

from __future__ import annotations

import types
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

from softmap_edge.diagnosis.document import SCHEMA as DIAGNOSIS
from softmap_edge.diagnosis.document import VERDICTS, Diagnosis
from softmap_edge.model.manifest import KINDS
from softmap_edge.model.manifest import SCHEMA as BUNDLE

Schema = dict[str, Any]
OMITTED = ("refitted", "meaning")  # keys that a diagnosis holds only where they say something


def number(doc: str = "", **limits: float) -> Schema:
    """Return the schema of a number."""
    return {"type": "number"} | limits | _described(doc)


def integer(doc: str = "", **limits: int) -> Schema:
    """Return the schema of an integer."""
    return {"type": "integer"} | limits | _described(doc)


def text(doc: str = "", **more: Any) -> Schema:
    """Return the schema of a text."""
    return {"type": "string"} | more | _described(doc)


def truth(doc: str = "") -> Schema:
    """Return the schema of true or false."""
    return {"type": "boolean"} | _described(doc)


def maybe(schema: Schema) -> Schema:
    """Return the schema of a value that may be null."""
    doc = schema.get("description", "")
    inner = {key: value for key, value in schema.items() if key != "description"}
    return {"anyOf": [inner, {"type": "null"}]} | _described(doc)


def rows(items: Schema, doc: str = "", **limits: int) -> Schema:
    """Return the schema of a list."""
    return {"type": "array", "items": items} | limits | _described(doc)


def table(values: Schema, doc: str = "") -> Schema:
    """Return the schema of an object with any keys."""
    return {"type": "object", "additionalProperties": values} | _described(doc)


def record(doc: str = "", optional: tuple[str, ...] = (), **properties: Schema) -> Schema:
    """Return the schema of an object whose keys are required, except those of `optional`."""
    names = [name.rstrip("_") for name in properties]
    return {
        "type": "object",
        "properties": dict(zip(names, properties.values())),
        "required": [name for name in names if name not in optional],
    } | _described(doc)


def constant(value: Any) -> Schema:
    """Return the schema of one value."""
    return {"const": value}


def _described(doc: str) -> Schema:
    return {"description": doc} if doc else {}


def of_type(hint: Any) -> Schema:
    """Return the schema of a value of an annotated type, dataclasses included."""
    origin, inner = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        kinds = [of_type(kind) for kind in inner if kind is not type(None)]
        return {"anyOf": [*kinds, {"type": "null"}]} if type(None) in inner else {"anyOf": kinds}
    if origin is Literal:
        return {"enum": list(inner)}
    if origin is tuple:
        return rows(of_type(inner[0]))
    if origin is dict:
        return table(of_type(inner[1]))
    if isinstance(hint, type) and is_dataclass(hint):
        hints = get_type_hints(hint)
        found = {f.name: of_type(hints[f.name]) for f in fields(hint)}
        needed = [
            f.name for f in fields(hint) if f.default is MISSING and f.default_factory is MISSING
        ]
        doc = " ".join((hint.__doc__ or "").split("\n\n")[0].split())
        return {"type": "object", "properties": found, "required": needed} | _described(doc)
    kinds = {str: "string", bool: "boolean", int: "integer", float: "number"}
    return {"type": kinds[hint]} if hint in kinds else {}


def diagnosis() -> Schema:
    """Return the schema of a diagnosis, from its dataclass."""
    hints = get_type_hints(Diagnosis, localns={"Model": Any})
    properties = {f.name: of_type(hints[f.name]) for f in fields(Diagnosis) if f.name != "model"}
    properties["verdict"] = {"enum": list(VERDICTS)}
    return {"type": "object", "properties": {"schema": constant(DIAGNOSIS)} | properties} | {
        "required": ["schema", *(name for name in properties if name not in OMITTED)]
    }


BIN = record(
    "a class of frames",
    label=text("its name"),
    low=maybe(number("lower bound of the condition")),
    high=maybe(number("upper bound")),
    n=integer("frames in it", minimum=0),
    rms_mm=number("error of these frames, mm RMS", minimum=0),
)
SHA256 = text(pattern="^[0-9a-f]{64}$")
NOTE = record(
    "what a run can or cannot show",
    about=text("the subject"),
    tells=truth("whether the run can show it"),
    text=text("the sentence that `softmap check` prints"),
    remedy=maybe(text("what to record")),
    minutes=maybe(number("time that this takes, min")),
)
SPAN = rows(number(), minItems=2, maxItems=2)

SCHEMAS: dict[str, Schema] = {
    DIAGNOSIS: diagnosis(),
    "softmap.comparison/1": record(
        schema=constant("softmap.comparison/1"),
        run=record(robot=text(), sha256=SHA256),
        bundle=record(robot=text(), effects=rows(text()), sha256=SHA256),
        frames=integer("frames that were compared", minimum=0),
        error=record(
            "distance of predicted and measured points, mm",
            rms_mm=number(minimum=0),
            median_mm=number(minimum=0),
            p95_mm=number(minimum=0),
            max_mm=number(minimum=0),
            tip_rms_mm=number(minimum=0),
        ),
        noise_floor_mm=maybe(number("noise of a point, mm RMS", minimum=0)),
        memoryless_floor=maybe(
            record(
                "lowest error of any model without memory on the frames of repeated poses",
                mm=number(minimum=0),
                error_mm=maybe(number("error of this model on these frames", minimum=0)),
                poses=integer("poses that were visited again", minimum=0),
                passages=integer("visits of them", minimum=0),
                frames=integer(minimum=0),
            )
        ),
        where=table(
            rows(BIN),
            "the error by condition: section, direction, speed, dwell, history, command, time, …",
        ),
        worst=record(
            bins=rows(record(where=text("condition"), label=text(), n=integer(), rms_mm=number())),
            frame=record(index=integer(), t_s=number(), rms_mm=number()),
        ),
        made_from=table({}, "versions, and how the noise floor was found"),
    ),
    "softmap.check/1": record(
        "of a run; that of a bundle has `kind` bundle and other keys",
        schema=constant("softmap.check/1"),
        path=text(),
        kind=constant("run"),
        sound=truth("false where the run must not be used as it is"),
        robot=text(),
        channels=integer(minimum=0),
        rows=integer("command rows", minimum=0),
        duration_s=number(minimum=0),
        rate_hz=maybe(number("command rows a second")),
        command_unit=text(),
        command_range=rows(SPAN, "low and high of each channel"),
        frames=integer(minimum=0),
        frame_rate_hz=maybe(number()),
        seen=maybe({"enum": ["vertices", "markers", "points"]}),
        points_mm=maybe(rows(SPAN, "low and high of x, y and z")),
        points_per_frame=maybe(integer()),
        visible_share=number(minimum=0, maximum=1),
        encoders=truth("whether positions of the servos are in the run"),
        gravity=maybe(text("its directions in the base frame")),
        load_g=maybe(SPAN),
        temperature_c=maybe(SPAN),
        blocks=rows(text(), "labels of the frames"),
        home_visits=integer(minimum=0),
        places_revisited=integer(minimum=0),
        missing=rows(text(), "sentences"),
        unseen_parts=rows(text(), "sentences on what was not seen; not sound if there are any"),
        warnings=rows(text(), "sentences"),
        can_tell=rows(NOTE),
        cannot_tell=rows(NOTE),
        hash=text("of the run; every document names a run by it"),
    ),
    "softmap.next/1": record(
        "which experiment settles what a diagnosis left open, best first",
        schema=constant("softmap.next/1"),
        next=rows(
            record(
                block=text("what to record"),
                minutes=number(minimum=0),
                settles=rows(text(), "alternatives and untestable effects"),
                separation=maybe(
                    number("expected chi² between the hypotheses; 25 or more is decisive")
                ),
            )
        ),
        blocks=rows(text(), "blocks in the command file"),
        settles=rows(text()),
        minutes=number(minimum=0),
        frames=integer(minimum=0),
        commands=maybe(text("the command file that was written")),
        by_hand=rows(record(t_s=number(), do=text("what a person does then"))),
        progress=rows(text(), "what was settled since the earlier diagnosis"),
    ),
    "softmap.demo/1": record(
        schema=constant("softmap.demo/1"),
        seed=integer(),
        hidden=rows({"type": "object"}, "the injected effects and their numbers"),
        diagnosis={"$ref": "softmap-diagnosis-2.json"},
        before_mm=number("error on the run that was never fitted, mm RMS", minimum=0),
        after_mm=number("the same with the effects that were found", minimum=0),
        floor_mm=number("error of the same finger with nothing hidden", minimum=0),
        floor_kind=text(),
        fall=maybe(number("share of the removable error that is gone")),
        frames=record(fitted=integer(), held_out=integer()),
        files=table(text(), "paths that were written"),
        seconds=number(minimum=0),
    ),
    "softmap.bundle/manifest": record(
        "`manifest.json` of a bundle",
        optional=(
            "input",
            "stiffness_known",
            "held_out_error_per_g_mm",
            "made_from",
            "output",
            "own_effects",
        ),
        schema=integer("of the bundle; an older one is read as well", minimum=1, maximum=BUNDLE),
        kind={"enum": list(KINDS), "description": "of the prior"},
        robot=text(maxLength=100),
        channels=integer("number of commands", minimum=0, maximum=64),
        command_unit=text(maxLength=100),
        length_unit=constant("mm"),
        input={
            "enum": ["present", "goal"],
            "description": "whether commands are measured or commanded positions",
        },
        command_range=rows(SPAN, "low and high of each channel, in the command's unit"),
        gravity_reference=rows(number(), "in the base frame, in g", minItems=3, maxItems=3),
        held_out_error_mm=number("the model error, mm RMS", minimum=0),
        held_out_error_per_g_mm=number("its error for a change of gravity by 1 g", minimum=0),
        stiffness_known=truth("false where loads have a nominal scale"),
        made_from=table({}),
        written_by=text(maxLength=100),
        output=table({}, "names, unit and scale of outputs that are no places"),
        own_effects=table(SHA256, "effects of the user by name"),
        sha256=table(SHA256, "the files of the bundle by name"),
    ),
    "softmap.bundle/effects": record(
        "`effects.json` of a bundle",
        chain=rows(text(), "effects in the order in which they act"),
        params=table(number(), "their numbers by label, such as `backlash.gap`"),
    ),
}
