"""Damaged files of arrays, .db3, folders and packed logs give an error of ours, within limits of
time and memory.

As test_mutated_logs.py; each format is one line of FORMATS. Foreign parsers run in a child of the
child.
"""

import gzip

import pytest
from containers import ARRAYS, arrays, messages, write_dataset, write_db3, write_folder, write_mat73
from damage import (
    Format,
    assert_10000,
    assert_some,
    run_all,
    spoil_bytes,
    spoil_npz_file,
    spoil_text,
)
from recordings import BAG_MAP as MAP
from recordings import write_mcap
from spoiled_bytes import LOG, spoil_binary, spoil_counts


# --- samples -------------------------------------------------------------------------------
def npz_sample(folder):
    import numpy as np

    np.savez(
        folder / "log.npz",
        **arrays(),
        part=np.array(["a", "b"] * 40),
        when=np.arange(80).astype("M8[ms]"),
    )
    return folder / "log.npz"


def npy_sample(folder):
    import numpy as np

    table = np.zeros(30, [("t", "<f8"), ("u", "<f4", 2), ("name", "U5")])
    table["t"], table["u"][:, 0] = np.arange(30), np.arange(30) % 7
    np.save(folder / "log.npy", table)
    return folder / "log.npy"


def mat_sample(folder, packed=False):
    import numpy as np
    import scipy.io

    cells = np.empty(3, object)
    cells[:] = ["a", np.zeros(2), {"x": np.ones((2, 2))}]
    values = arrays(20) | {
        "log": {"x": np.arange(20.0), "in": {"y": np.eye(3)}},
        "c": cells,
        "title": "a text",
    }
    scipy.io.savemat(folder / "log.mat", values, do_compression=packed)
    return folder / "log.mat"


def packed_mat_sample(folder):
    return mat_sample(folder, packed=True)


def old_mat_sample(folder):
    import scipy.io

    scipy.io.savemat(folder / "log.mat", arrays(20), format="4")
    return folder / "log.mat"


def mat73_sample(folder):
    return write_mat73(folder / "log.mat", arrays(20) | {"log.x": arrays(20)["t"]})


def hdf5_sample(folder):
    import h5py
    import numpy as np

    with h5py.File(folder / "log.h5", "w", libver="latest") as file:
        for name, value in arrays(40).items():
            file.create_dataset(
                f"run/{name}", data=value, chunks=True, compression="gzip", fletcher32=True
            )
        file["names"] = ["a", "b"] * 20
        file["table"] = np.zeros(40, [("a", "<f4"), ("b", "<i2")])
    return folder / "log.h5"


def dataset_sample(folder):
    return write_dataset(folder / "set")


def parquet_sample(folder):
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns = {name: pa.array(value.tolist()) for name, value in arrays(40).items()}
    columns["part"] = pa.array(["a", "b"] * 20).dictionary_encode()
    pq.write_table(pa.table(columns), folder / "log.parquet", compression="none")
    return folder / "log.parquet"


def db3_sample(folder):
    return write_db3(folder / "run.db3", messages(12), definitions=True)


def folder_sample(folder):
    made = write_folder(folder / "bag", ["bag_0.db3", "bag_1.mcap"])
    write_db3(made / "bag_0.db3", messages(20, last=10))
    write_mcap(made / "bag_1.mcap", messages(20, first=10))
    return made


def gzip_sample(folder):
    (folder / "log.csv.gz").write_bytes(gzip.compress(named_log()))
    return folder / "log.csv.gz"


def zstd_sample(folder):
    import zstandard

    (folder / "log.csv.zst").write_bytes(
        zstandard.ZstdCompressor(write_checksum=True).compress(named_log())
    )
    return folder / "log.csv.zst"


def named_log():
    return LOG.replace("t,a,b,x,y,z", "time_s,u1,phi1,tip_x,tip_y,tip_z").encode()


# --- damage --------------------------------------------------------------------------------
def spoil_in_folder(name, spoil):
    """Spoil one file of a folder by a function of its bytes, and copy the others."""

    def spoilt(sample, folder, rng):
        for path in sorted(sample.rglob("*")):
            if path.is_file():
                place = folder / sample.name / path.relative_to(sample)
                place.parent.mkdir(parents=True, exist_ok=True)
                place.write_bytes(
                    spoil(path.read_bytes(), rng) if path.name == name else path.read_bytes()
                )
        return folder / sample.name

    return spoilt


def text_of(data, rng):
    return spoil_text(data.decode(), rng)


# --- use -----------------------------------------------------------------------------------
def use(path):
    """Propose a mapping and try it; what is proposed can be parsed."""
    from softmap_edge.logs.guess import guess_mapping
    from softmap_edge.logs.mapping import parse_mapping

    parse_mapping(guess_mapping([path]).text, path)


def use_arrays(path):
    from softmap_edge.logs.importer import import_logs
    from softmap_edge.logs.mapping import parse_mapping

    import_logs([path], parse_mapping(ARRAYS, path))


def use_bag(path):
    from softmap_edge.logs.importer import import_logs
    from softmap_edge.logs.mapping import parse_mapping

    import_logs([path], parse_mapping(MAP, path))


FORMATS = [
    Format("npz log", npz_sample, spoil_npz_file, use_arrays),
    Format("npz log bytes", npz_sample, spoil_binary, use),
    Format("npy counts", npy_sample, spoil_counts, use, felt=0.05),
    Format("mat", mat_sample, spoil_binary, use),
    Format("mat packed", packed_mat_sample, spoil_binary, use),
    Format("mat counts", mat_sample, spoil_counts, use),
    Format("mat v4 counts", old_mat_sample, spoil_counts, use),
    Format("mat v7.3", mat73_sample, spoil_binary, use),
    Format("mat v7.3 counts", mat73_sample, spoil_counts, use),
    Format("hdf5", hdf5_sample, spoil_binary, use),
    Format("hdf5 counts", hdf5_sample, spoil_counts, use),
    Format("parquet", parquet_sample, spoil_binary, use),
    Format("parquet counts", parquet_sample, spoil_counts, use),
    Format("dataset", dataset_sample, spoil_in_folder("file-000.parquet", spoil_bytes), use),
    Format("dataset info", dataset_sample, spoil_in_folder("info.json", text_of), use),
    Format("db3", db3_sample, spoil_binary, use_bag),
    Format("db3 counts", db3_sample, spoil_counts, use_bag, felt=0.05),
    Format(
        "metadata",
        folder_sample,
        spoil_in_folder("metadata.yaml", text_of),
        use_bag,
        felt=0.01,
    ),
    Format("gzip", gzip_sample, spoil_binary, use),
    Format("zstd", zstd_sample, spoil_binary, use),
]
names = [form.name for form in FORMATS]


@pytest.mark.parametrize("form", FORMATS, ids=names)
def test_damaged_containers(form, tmp_path):
    assert_some(__file__, form, tmp_path)


@pytest.mark.long
@pytest.mark.parametrize("form", FORMATS, ids=names)
def test_500_damaged_containers(form, tmp_path):
    assert_some(__file__, form, tmp_path, 500)


@pytest.mark.prove
@pytest.mark.parametrize("form", FORMATS, ids=names)
def test_10000_damaged_containers(form, tmp_path):
    assert_10000(__file__, form, tmp_path)


if __name__ == "__main__":
    run_all(FORMATS)
