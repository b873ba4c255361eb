"""Arrays come back exactly as saved, or an error says in one line why not."""

import io
import pickle
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from foveate.io.npz import load_arrays, save_arrays

HEADER = {"format": "foveate-policy", "version": 2, "config": {"frame": "body", "widths": [32, 64]}}
ARRAYS = {
    "weight": np.arange(6.0, dtype=np.float32).reshape(2, 3),
    "step": np.array(7),
    "κ/0": np.zeros((0, 4)),
}


def same(arrays: dict[str, np.ndarray], others: dict[str, np.ndarray]) -> bool:
    return list(arrays) == list(others) and all(
        (a.dtype, a.shape, a.tobytes()) == (b.dtype, b.shape, b.tobytes())
        for a, b in zip(arrays.values(), others.values(), strict=True)
    )


def saved(folder: Path) -> Path:
    save_arrays(folder / "policy.npz", ARRAYS, HEADER)
    return folder / "policy.npz"


def with_members(path: Path, members: dict[str, bytes], compression: int = zipfile.ZIP_STORED) -> Path:
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return path


def rejection(path: Path, kind: str = "policy", newest: int = 2) -> str:
    """The one line with which a file is rejected."""
    with pytest.raises(ValueError, match=path.name) as caught:
        load_arrays(path, kind, newest)
    assert len(str(caught.value).splitlines()) == 1
    return str(caught.value)


@settings(deadline=None, max_examples=50)
@given(
    arrays=st.dictionaries(
        st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=5).filter(lambda n: n != "header"),
        hnp.arrays(
            hnp.scalar_dtypes().filter(lambda dtype: np.dtype(dtype.str) == dtype),
            hnp.array_shapes(min_dims=0, min_side=0, max_side=3),
        ),
        max_size=3,
    )
)
def test_arrays_and_header_round_trip(tmp_path_factory: pytest.TempPathFactory, arrays: dict[str, np.ndarray]):
    path = tmp_path_factory.getbasetemp() / "any.npz"
    save_arrays(path, arrays, HEADER)
    header, loaded = load_arrays(path, "policy", 2)
    assert header == HEADER
    assert same(loaded, arrays)


def test_transposed_and_strided_arrays_keep_their_values(tmp_path: Path):
    base = np.arange(24).reshape(4, 6)
    save_arrays(tmp_path / "a.npz", {"turned": base.T, "every": base[::2, ::3]}, HEADER)
    _, loaded = load_arrays(tmp_path / "a.npz", "policy", 2)
    np.testing.assert_array_equal(loaded["turned"], base.T)
    np.testing.assert_array_equal(loaded["every"], base[::2, ::3])


def test_numpy_reads_the_file_without_us(tmp_path: Path):
    with np.load(saved(tmp_path), allow_pickle=False) as archive:
        np.testing.assert_array_equal(archive["weight"], ARRAYS["weight"])
        assert archive["header"].dtype == np.uint8


def test_same_content_gives_the_same_bytes(tmp_path: Path):
    first = saved(tmp_path).read_bytes()
    assert saved(tmp_path).read_bytes() == first


@pytest.mark.parametrize("mask", [0xFF, 0x01, 0x08])
def test_a_changed_byte_is_detected_or_harmless(tmp_path: Path, mask: int):
    path = saved(tmp_path)
    whole = path.read_bytes()
    errors = []
    for position in range(len(whole)):
        path.write_bytes(whole[:position] + bytes([whole[position] ^ mask]) + whole[position + 1 :])
        try:
            header, arrays = load_arrays(path, "policy", 2)
        except ValueError as error:
            errors.append(str(error))
        else:
            assert header == HEADER
            assert same(arrays, ARRAYS)
    assert all(error.startswith(f"{path}: ") and len(error.splitlines()) == 1 for error in errors)
    assert len(errors) > 0.8 * len(whole)  # the rest are dates and hints that nobody reads


def test_a_truncated_file_is_rejected_at_any_length(tmp_path: Path):
    path = saved(tmp_path)
    whole = path.read_bytes()
    for length in range(2, len(whole)):
        path.write_bytes(whole[:length])
        assert "is cut short or damaged" in rejection(path)


def test_changed_content_with_right_checksums_is_rejected(tmp_path: Path):
    path = saved(tmp_path)
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    other = dict(members)
    other["weight.npy"] = other["weight.npy"][:-1] + b"\x01"
    assert "is damaged: its content is not what was written" in rejection(with_members(path, other))
    del other["weight.npy"]
    assert "is damaged" in rejection(with_members(path, other))
    other = {**members, "header.npy": members["header.npy"].replace(b'"body"', b'"bodx"')}
    assert "is damaged" in rejection(with_members(path, other))


def test_another_kind_and_a_newer_version_are_rejected(tmp_path: Path):
    path = saved(tmp_path)
    assert "has the format 'foveate-policy'; expected 'foveate-scenes'" in rejection(path, kind="scenes")
    assert "has version 2; this foveate reads 1 to 1" in rejection(path, newest=1)


def test_missing_and_foreign_files_are_rejected(tmp_path: Path):
    assert "there is no such file; give the name of a policy file" in rejection(tmp_path / "absent.npz")
    assert "is a folder" in rejection(tmp_path)
    path = tmp_path / "foreign.npz"
    for content in (b"", b"P", b"time_s,track_id\n", pickle.dumps({})):
        path.write_bytes(content)
        assert "is not an .npz archive; give a policy file" in rejection(path)
    np.savez(path, weight=np.ones(3))
    assert "has no header; give a policy file" in rejection(path)


@pytest.mark.parametrize("text", [b"[]", b"{", b"\xff", b"null"])
def test_a_header_that_is_no_table_is_rejected(tmp_path: Path, text: bytes):
    np.savez(tmp_path / "odd.npz", header=np.frombuffer(text, np.uint8))
    rejection(tmp_path / "odd.npz")


@pytest.mark.parametrize("version", [0, "2", True, None, 1.0])
def test_a_version_that_is_no_whole_number_is_rejected(tmp_path: Path, version: Any):
    text = f'{{"format": "foveate-policy", "version": {"null" if version is None else repr(version).lower()}}}'
    np.savez(tmp_path / "odd.npz", header=np.frombuffer(text.replace("'", '"').encode(), np.uint8))
    assert "expected a whole number from 1 to 2" in rejection(tmp_path / "odd.npz")
    with pytest.raises(ValueError, match="expected a whole number of 1 or more"):
        save_arrays(tmp_path / "odd.npz", {}, {**HEADER, "version": version})


class Trap:
    """Leaves a mark where it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = mark

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.mark,)


def test_pickles_are_never_executed(tmp_path: Path):
    mark, path = tmp_path / "executed", tmp_path / "trap.npz"
    pickle.loads(pickle.dumps(Trap(mark)))
    assert mark.exists()
    mark.unlink()
    trap = np.empty(1, object)
    trap[0] = Trap(mark)
    for name in ("weight", "header"):
        np.savez(path, allow_pickle=True, **{name: trap})
        assert "is cut short or damaged" in rejection(path)
    with_members(path, {"weight": pickle.dumps(Trap(mark))})
    assert "strange member 'weight'" in rejection(path)
    path.write_bytes(pickle.dumps(Trap(mark)))
    assert "is not an .npz archive" in rejection(path)
    assert not mark.exists()


def test_archives_that_unpack_beyond_their_stated_size_are_rejected(tmp_path: Path):
    zeros = io.BytesIO()
    np.save(zeros, np.zeros(100_000))
    path = with_members(tmp_path / "bomb.npz", {"a.npy": zeros.getvalue()}, zipfile.ZIP_DEFLATED)
    assert "its members are larger than the file" in rejection(path)
    noise = io.BytesIO()
    np.save(noise, np.random.default_rng(0).random(20))  # which no compression makes smaller
    assert "strange member 'a.npy'" in rejection(with_members(path, {"a.npy": noise.getvalue()}, zipfile.ZIP_DEFLATED))
    claim = zeros.getvalue()[:128].replace(b"(100000,)", b"(1<<60,)".replace(b"1<<60", b"9" * 6))
    assert "is cut short or damaged" in rejection(with_members(path, {"a.npy": claim}))


def overlapping(path: Path, count: int, size: int) -> Path:
    """An archive whose entries are all the same bytes, as a bomb has them."""
    member = io.BytesIO()
    np.save(member, np.zeros(size // 8))
    with_members(path, {f"{i:04}.npy": member.getvalue() if i == 0 else b"" for i in range(count)})
    data = bytearray(path.read_bytes())
    entry = first = data.index(b"PK\x01\x02")
    for _ in range(count):
        data[entry + 16 : entry + 28] = data[first + 16 : first + 28]  # checksum and sizes of the first
        data[entry + 42 : entry + 46] = data[first + 42 : first + 46]  # where it lies
        entry = data.index(b"PK\x01\x02", entry + 1) if data.count(b"PK\x01\x02", entry + 1) else entry
    path.write_bytes(bytes(data))
    return path


def test_members_that_overlap_are_rejected_before_any_is_read(tmp_path: Path):
    """1,500 entries of one and the same 2 MB would be 3 GB."""
    path = overlapping(tmp_path / "bomb.npz", 1500, 2_000_000)
    assert path.stat().st_size < 3_000_000
    tracemalloc.start()
    try:
        assert "its members are larger than the file" in rejection(path)
        assert tracemalloc.get_traced_memory()[1] < 20 * path.stat().st_size
    finally:
        tracemalloc.stop()


def test_an_array_that_claims_more_than_it_has_is_never_made(tmp_path: Path):
    for shape in ((10**12,), (4, 0), (-4,), (-2, -2), (2**63, 2**63)):
        member = io.BytesIO()
        np.lib.format.write_array_header_1_0(member, {"descr": "<f8", "fortran_order": False, "shape": shape})
        claim = member.getvalue() + bytes(32)
        tracemalloc.start()
        try:
            assert "is cut short or damaged" in rejection(with_members(tmp_path / "a.npz", {"a.npy": claim}))
            assert tracemalloc.get_traced_memory()[1] < 3_000_000
        finally:
            tracemalloc.stop()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('{"a":' * 990 + "1" + "}" * 990, "lists and objects in one another"),
        ('{"format": "foveate-policy", "version": 1, "score": NaN}', "NaN is not JSON"),
        ('{"format": "foveate-policy", "version": 1, "digest": null}', "is damaged"),
        ('{"format": "foveate-policy", "version": 1, "version": 2}', "'version' is given twice"),
    ],
)
def test_a_header_that_is_not_strict_json_is_rejected(tmp_path: Path, text: str, words: str):
    np.savez(tmp_path / "odd.npz", header=np.frombuffer(text.encode(), np.uint8))
    assert words in rejection(tmp_path / "odd.npz")


@pytest.mark.parametrize("array", [np.zeros(2, "V8"), np.zeros(2, [("x", float)])])
def test_arrays_without_numbers_are_rejected(tmp_path: Path, array: np.ndarray):
    np.savez(tmp_path / "odd.npz", header=np.frombuffer(b"{}", np.uint8), weight=array)
    assert "an array of type" in rejection(tmp_path / "odd.npz")


@pytest.mark.parametrize(
    ("arrays", "header", "problem"),
    [
        ({"header": np.ones(1)}, {}, "an array cannot be named 'header'"),
        ({"a\0b": np.ones(1)}, {}, "an array cannot be named"),
        ({"a": np.array([None])}, {}, "has the type object; expected a plain number"),
        ({"a": np.zeros(1, [("x", float)])}, {}, "expected a plain number"),
        ({}, {"format": "numpy"}, "header format 'numpy'; expected 'foveate-'"),
        ({}, {"digest": "0"}, "the header's key 'digest' is taken"),
        ({}, {"score": float("nan")}, "the header cannot be written"),
    ],
)
def test_saving_rejects_arrays_that_do_not_round_trip(
    tmp_path: Path, arrays: dict[str, np.ndarray], header: dict[str, Any], problem: str
):
    with pytest.raises(ValueError, match=problem):
        save_arrays(tmp_path / "a.npz", arrays, {**HEADER, **header})
    assert not (tmp_path / "a.npz").exists()


def test_bfloat16_is_rejected_because_npy_loses_it(tmp_path: Path):
    import ml_dtypes

    with pytest.raises(ValueError, match="'a' has the type bfloat16; expected a plain number"):
        save_arrays(tmp_path / "a.npz", {"a": np.ones(2, ml_dtypes.bfloat16)}, HEADER)
