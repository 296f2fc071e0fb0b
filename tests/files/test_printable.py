"""Control characters of names and paths reach neither a terminal nor a page."""

import io
import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from softmap_edge.cli import main
from softmap_edge.files.printable import PrintableStream, listed, one_line, printable, raw
from softmap_edge.report.pages import render
from softmap_edge.run.run import Run

HOSTILE = {
    "\x1b[31m": "\\u001b[31m",
    "a\rb": "a\\u000db",
    "\x07": "\\u0007",
    "\x7f\x9b": "\\u007f\\u009b",
    "\u202ecod.exe": "\\u202ecod.exe",
    "\u2066x\u2069": "\\u2066x\\u2069",
    "\udcff": "\\udcff",
    "\U000e0041": "\\udb40\\udc41",
}
FRIENDLY = ["", "plain", "µm ± 0.3 °, 12 mm", "a\tb\nc", "零件 🤖", "é"]


@pytest.mark.parametrize("text", HOSTILE)
def test_what_does_not_print_is_escaped(text):
    assert printable(text) == HOSTILE[text]
    assert one_line(f"{text}\nx").count("\n") == 0
    assert json.loads(f'"{printable(text)}"') == text


@pytest.mark.parametrize("text", FRIENDLY)
def test_what_prints_stays(text):
    assert printable(text) == text


@pytest.mark.parametrize(
    "path", ["ev\x1b[31mil\nline", "a\rsoftmap: all is well", "\u202egnp.exe", "x\x9b2J"]
)
def test_a_path_is_one_plain_line(capsys, path):
    assert main(["show", path]) == 2
    error = capsys.readouterr().err
    assert error.endswith("\n") and error[:-1].isprintable()


def test_an_unknown_command_is_one_plain_line(capsys):
    assert main(["sho\x1b[2Jw\n"]) == 2
    assert capsys.readouterr().err[:-1].isprintable()


def test_whatever_a_command_prints_is_escaped(monkeypatch):
    out = io.StringIO()
    monkeypatch.setattr(sys, "stdout", out)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("softmap_edge.cli._run", lambda *_: print("name\x1b]0;title\x07") or 0)
        assert main(["show", "x"]) == 0
    assert out.getvalue() == "name\\u001b]0;title\\u0007\n" and sys.stdout is out


def test_what_moves_the_cursor_on_purpose_goes_past_it():
    out = io.StringIO()
    print("\rhalf", end="", file=raw(PrintableStream(out)))
    assert out.getvalue() == "\rhalf" and raw(out) is out


def test_a_page_shows_every_value_as_text_without_control_characters(tmp_path):
    """Whatever a template does with a value: shown, joined, filtered, in an attribute, through a
    macro.
    """
    (tmp_path / "t.html").write_text(
        "{% macro m(x) %}{{ x }}{% endmacro %}{{ page.a }}|{{ [page.a, page.a] | join(' ') }}|{{ "
        "m(page.a) }}|"
        '<i alt="{{ page.a }}">{{ page.a ~ "!" }}'
    )
    text = render("t.html", SimpleNamespace(a='<b onload="x">\x1b[1m'), tmp_path)
    one = "&lt;b onload=&#34;x&#34;&gt;\\u001b[1m"
    assert text == f'{one}|{one} {one}|{one}|<i alt="{one}">{one}!'


@pytest.mark.parametrize("name", ["a\nsoftmap: all is well.npz", "a\tb.npz", "a\rb.npz", "\n"])
@pytest.mark.parametrize("words", [["show"], ["check"], ["import", "log.csv", "--guess", "--out"]])
def test_a_name_with_a_line_end_or_a_tab_is_refused(words, name, capsys):
    assert main([*words, name]) == 2
    out, error = capsys.readouterr()
    assert out == "" and error[:-1].isprintable() and "rename the file" in error


@pytest.mark.parametrize("name", ["a\nb", "tab\t", "line\u2028line", "\u202egnp"])
def test_the_fields_of_a_run_are_printed_on_one_line(name, tmp_path, capsys):
    t = np.arange(3.0)
    markers = np.ones((3, 1, 3)) * t[:, None, None] * 10
    path = tmp_path / "run.npz"
    Run(t=t, command=t[:, None], markers=markers, t_seen=t, extra={name: np.array(name)}).save(path)
    main(["show", str(path)])
    shown = capsys.readouterr().out
    assert all(line.isprintable() for line in shown.splitlines()) and one_line(name) in shown
    assert name not in shown


@pytest.mark.parametrize("name", ["a\nb", "tab\t", "\x1b[31m"])
def test_names_in_a_list_are_one_line(name):
    assert listed([name, "x"], 1) == f"{one_line(name)} and 1 more"
