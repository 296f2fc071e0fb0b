"""`make data` brings the published measurements, checks them, and takes nothing else."""

import hashlib
import http.server
import importlib.util
import sys
import threading
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


def fetcher():
    spec = importlib.util.spec_from_file_location("fetch_data", ROOT / "examples" / "fetch_data.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules["fetch_data"] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def server(tmp_path):
    """A local web server over a folder; yields the folder and its address."""
    folder = tmp_path / "web"
    folder.mkdir()

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def __init__(self, *args):
            super().__init__(*args, directory=str(folder))

        def log_message(self, *_):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Quiet) as web:
        thread = threading.Thread(target=web.serve_forever, daemon=True)
        thread.start()
        yield folder, f"http://127.0.0.1:{web.server_address[1]}"
        web.shutdown()
        thread.join()


def published(module, folder, content=b"1,2,3\n"):
    source = module.Source(
        "toy",
        "a toy",
        "somebody/robot",
        "0" * 40,
        "MIT",
        {"log.csv": ("a b/log.csv", hashlib.sha256(content).hexdigest())},
    )
    place = folder / "somebody" / "robot" / ("0" * 40) / "a b"
    place.mkdir(parents=True)
    (place / "log.csv").write_bytes(content)
    return source


def test_data_is_downloaded_checked_and_not_twice(server, tmp_path):
    module, (web, url) = fetcher(), server
    source = published(module, web)
    assert "1 downloaded" in module.fetch(tmp_path / "data", [source], url, None)[0]
    assert (tmp_path / "data" / "toy" / "log.csv").read_bytes() == b"1,2,3\n"
    (web / "somebody" / "robot" / ("0" * 40) / "a b" / "log.csv").unlink()
    assert "1 already there" in module.fetch(tmp_path / "data", [source], url, None)[0]
    near = module.fetch(tmp_path / "other", [source], url, tmp_path / "data")
    assert "1 copied" in near[0] and "licence MIT" in near[0]
    with pytest.raises(module.FetchError, match="cannot be had"):
        module.fetch(tmp_path / "third", [source], url, None)


def test_another_file_than_the_published_one_is_refused(server, tmp_path):
    module, (web, url) = fetcher(), server
    source = published(module, web)
    (web / "somebody" / "robot" / ("0" * 40) / "a b" / "log.csv").write_bytes(b"4,5,6\n")
    with pytest.raises(module.FetchError, match="SHA-256"):
        module.fetch(tmp_path / "data", [source], url, None)
    assert not list((tmp_path / "data").rglob("*.csv*"))
    damaged = tmp_path / "near" / "toy"
    damaged.mkdir(parents=True)
    (damaged / "log.csv").write_bytes(b"7")
    with pytest.raises(module.FetchError):  # a damaged neighbour is not taken either
        module.fetch(tmp_path / "data", [source], url, tmp_path / "near")


def test_the_table_of_sources_is_complete(capsys, tmp_path):
    module = fetcher()
    assert {"trunk", "tdcr", "beam", "moe_finger", "hand"} == {
        source.name for source in module.SOURCES
    }
    for source in module.SOURCES:
        assert len(source.commit) == 40 and source.licence
        assert source.url(next(iter(source.files)), module.BASE_URL).startswith(
            "https://raw.githubusercontent.com/"
        )
        assert all(len(sha256) == 64 for _, sha256 in source.files.values())
    assert module.main([str(tmp_path), "nonsense"]) == 2
    assert "trunk" in capsys.readouterr().err


def test_the_nearby_data_is_the_published_one(tmp_path):
    module = fetcher()
    if not module.NEARBY.is_dir():
        pytest.skip("not run: ../shared/data is not here")
    assert module.main([str(tmp_path / "data")]) == 0
    assert (tmp_path / "data" / "trunk" / "LICENSE").is_file()
