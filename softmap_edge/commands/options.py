"""Options of `compare` and `record`: each command has one module for its parser and one for robots.

Both modules import the options from here, so that neither imports the other for a type.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class CompareOptions:
    """Options of `softmap compare`, as its parser declares them."""

    run: str
    live: bool
    camera: str | None
    key: str | None
    like: str | None
    late: float | None
    seconds: float | None
    bundle: list[str] | None
    effects: list[str]
    trust_onnx: bool
    html: str | None
    json: bool


@dataclass(frozen=True)
class RecordOptions:
    """Options of `softmap record`, as its parser declares them."""

    commands: str
    sim: bool
    emulated: bool
    rig: str | None
    recover: str | None
    camera: str | None
    key: str | None
    like: str | None
    late: float | None
    yes: bool
    record: str | None
    calibrated: str | None
    virtual: bool
    truth: str | None
    bundle: str | None
    effects: list[str]
    trust_onnx: bool
    finger: str | None
    hide: list[str]
    truth_from: str | None
    seed: int | None
    noise_seed: int
    out: str
    json: bool
