"""Runs with laws that the library lacks."""

from types import SimpleNamespace

import numpy as np

from softmap_edge.diagnosis.laws import Law, _Asked


def played(u, gaps):
    """Commands behind plays of these widths, one a channel."""
    out, y = np.empty_like(u), u[0].copy()
    for k, row in enumerate(u):
        y = out[k] = np.clip(y, row - np.asarray(gaps) / 2, row + np.asarray(gaps) / 2)
    return out


def law(name, loss, numbers, **params):
    """A law with eight even folds; several effects are joined by +, generic laws are in
    brackets.
    """
    effects = () if name[0] == "(" else tuple(name.split("+"))
    labels = [label for label in params if label.endswith(("+]", "-]"))]
    space = SimpleNamespace(split=effects if labels else (), free_labels=labels)
    fit = SimpleNamespace(params=params, x=np.zeros(0), space=space) if effects else None
    return Law(name, effects, fit, np.full(8, loss / 8), numbers)


def judged(
    *laws, representative=100.0, before=1000.0, half=10.0, kind="static", spool=None, noisy=False
):
    """The answer of level 2 for a family whose representative leaves `representative` of
    `before`.
    """
    asked = object.__new__(_Asked)
    asked.form, asked.before = 0.025, np.full(8, before / 8)
    asked.representative = SimpleNamespace(
        family=SimpleNamespace(name="static map", kind=kind),
        loss=np.full(8, representative / 8), left=representative, numbers=9.0,
    )  # fmt: skip
    asked.fits = SimpleNamespace(candidates=["gain", "offset", "asymmetry", "eccentric_pulley"])
    record = SimpleNamespace(spool=spool, error_is_noise=noisy)
    asked.body = SimpleNamespace(
        half=np.array([half]), problem=SimpleNamespace(numbers=60.0), record=record
    )
    return asked.answer_of(list(laws))
