"""Text logs in UTF-16 and UTF-32, with and without a mark of byte order, are read as those in UTF-8
are.
"""

import codecs

import pytest
from bench_rows import NAMES, rows, write

from softmap_edge.errors import RunError
from softmap_edge.logs.guess import guess_mapping
from softmap_edge.logs.importer import import_logs
from softmap_edge.logs.mapping import parse_mapping
from softmap_edge.logs.readers.encoding import encoding_of, encoding_of_start, is_cut

TEXT = "\n".join([",".join(NAMES), *rows(60)]) + "\n"
WAYS = {
    "UTF-16 LE, as Excel writes it": codecs.BOM_UTF16_LE + TEXT.encode("utf-16-le"),
    "UTF-16 BE": codecs.BOM_UTF16_BE + TEXT.encode("utf-16-be"),
    "UTF-16 LE without a mark": TEXT.encode("utf-16-le"),
    "UTF-16 BE without a mark": TEXT.encode("utf-16-be"),
    "line ends of Windows": codecs.BOM_UTF16_LE + TEXT.replace("\n", "\r\n").encode("utf-16-le"),
    "tabs and an umlaut": codecs.BOM_UTF16_LE
    + TEXT.replace(",", "\t").replace("time", "time\u00e4", 0).encode("utf-16-le"),
    "UTF-32": TEXT.encode("utf-32"),
    "UTF-32 LE without a mark": TEXT.encode("utf-32-le"),
    "UTF-32 BE without a mark": TEXT.encode("utf-32-be"),
    "UTF-8 with a mark": TEXT.encode("utf-8-sig"),
}


@pytest.mark.parametrize("way", WAYS)
def test_every_encoding_gives_the_same_run(tmp_path, way):
    plain = write(tmp_path / "plain.csv", ",".join(NAMES), rows(60))
    (tmp_path / "wide.csv").write_bytes(WAYS[way])
    runs = []
    for path in (plain, tmp_path / "wide.csv"):
        found = guess_mapping([path])
        runs.append(import_logs([path], parse_mapping(found.text, path)).run)
    assert (runs[0].markers == runs[1].markers).all() and (runs[0].t == runs[1].t).all()


def test_a_name_keeps_its_letters(tmp_path):
    (tmp_path / "log.csv").write_bytes(TEXT.replace("time", "Zeit \u00e4 time").encode("utf-16"))
    assert encoding_of(tmp_path / "log.csv") == ("utf-16", None)
    assert '"Zeit \u00e4 time"' in guess_mapping([tmp_path / "log.csv"]).text


ENDS = {
    "UTF-16 LE": ("utf-16-le", codecs.BOM_UTF16_LE, 1),
    "UTF-16 BE": ("utf-16-be", codecs.BOM_UTF16_BE, 1),
    "UTF-16 LE without a mark": ("utf-16-le", b"", 1),
    "UTF-16 BE without a mark": ("utf-16-be", b"", 1),
    "UTF-32": ("utf-32-le", codecs.BOM_UTF32_LE, 3),
    "UTF-32 BE without a mark": ("utf-32-be", b"", 2),
    "UTF-8": ("utf-8", b"", 1),
    "UTF-8 with a mark": ("utf-8", codecs.BOM_UTF8, 1),
}


@pytest.mark.parametrize("way", ENDS)
@pytest.mark.parametrize("last", ["\u00e4", "\u20ac", "\U0001f916"])
def test_a_file_that_ends_within_a_character_is_read_up_to_it(tmp_path, way, last):
    encoding, mark, cut = ENDS[way]
    text = TEXT.replace("time", "größe time").rstrip("\n") + last
    (tmp_path / "log.csv").write_bytes(mark + text.encode(encoding)[:-cut])
    found = guess_mapping([tmp_path / "log.csv"])
    assert "größe time" in found.text
    done = import_logs([tmp_path / "log.csv"], parse_mapping(found.text, tmp_path))
    assert len(done.run.t) == 60 and done.run.t[-1] == pytest.approx(59 * 0.05)
    assert any("ends within a character of line 61" in doubt for doubt in done.doubts)


@pytest.mark.parametrize("way", ENDS)
def test_a_row_that_was_cut_within_a_character_is_left_out_by_the_key(tmp_path, way):
    encoding, mark, cut = ENDS[way]
    text = TEXT[: TEXT.rindex(",")] + ",\u00e4"
    (tmp_path / "log.csv").write_bytes(mark + text.encode(encoding)[:-cut])
    mapping = guess_mapping([tmp_path / "log.csv"]).text
    done = import_logs([tmp_path / "log.csv"], parse_mapping(mapping, tmp_path))
    assert any("skip_last_rows = 1" in doubt for doubt in done.doubts)
    mapping = mapping.replace("[[log]]\n", "[[log]]\nskip_last_rows = 1\n")
    done = import_logs([tmp_path / "log.csv"], parse_mapping(mapping, tmp_path))
    assert len(done.run.t) == 59 and not any("cut" in doubt for doubt in done.doubts)


@pytest.mark.parametrize("whole", ["\u00e4", "\u20ac", "\U0001f916", "a"])
@pytest.mark.parametrize(
    "encoding", ["utf-8", "utf-16", "utf-16-le", "utf-16-be", "utf-32", "utf-32-be"]
)
def test_a_complete_last_character_is_no_cut(tmp_path, whole, encoding):
    (tmp_path / "log.csv").write_bytes((TEXT + whole).encode(encoding))
    assert not is_cut(tmp_path / "log.csv")


@pytest.mark.parametrize(
    "start",
    [bytes(400), b"\0\1" * 200, bytes(range(256)), b"t,a\0b\n" * 30, b"\x01\x00\x00\x02" * 50],
)
def test_bytes_that_are_no_text_stay_an_error(tmp_path, start):
    (tmp_path / "log.csv").write_bytes(start)
    with pytest.raises(RunError):
        guess_mapping([tmp_path / "log.csv"])


def test_plain_text_is_utf_8():
    for start in (b"", b"t", b"t,a\n1,2\n", TEXT.encode()[:4096], b"\xef\xbb\xbft,a\n"):
        assert encoding_of_start(start) == "utf-8-sig"
