"""Effects written by a user, in files, and their entry into the library."""

import numpy as np

from softmap_edge.model.user_effect import forget_effect, loaded


def forgotten():
    """Other tests go through all effects that there are."""
    yield
    for name in loaded():
        forget_effect(name)


def entered(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def written(folder, text, name="mine.py"):
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def effect(law, name="mine", **declared):
    """A file of one parameter `by` (B, 1, 1), null 0, and the law given as an expression or as the
    body of rollout.
    """
    number = {
        "name": "by",
        "unit": "1",
        "null": 0.0,
        "start": 0.1,
        "low": -1.0,
        "high": 1.0,
        "doc": "how much",
    }
    texts = {key: "said" for key in ("formula", "doc", "signature")}
    table = {"name": name, "stage": "material", **texts, "parameters": [number]} | declared
    body = law if "\n" in law else f"    return {law}\n"
    head = (
        "import numpy as np\n\n\ndef rollout(params, u, t, ctx):\n    by = params[:, 0, None, "
        "None]\n"
    )
    return f"{head}{body}\n\nEFFECT = {table!r}\n"


def record(samples=60):
    t = np.cumsum(np.random.default_rng(1).uniform(0.02, 0.2, samples))
    return t, np.random.default_rng(2).uniform(-9.0, 9.0, (samples, 2))


def number(**changed):
    return {
        "parameters": [
            {
                "name": "by",
                "unit": "1",
                "null": 0.0,
                "start": 0.1,
                "low": -1.0,
                "high": 1.0,
                "doc": "x",
            }
            | changed
        ]
    }
