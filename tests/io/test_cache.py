"""Jobs are computed once, and again when their key or file does not fit."""

import numpy as np
import pytest

from foveate.io.cache import Job


def job(path, key="a", computed=None, optional=False):
    def compute(value):
        if computed is not None:
            computed.append(value)
        return np.array([value, 2.0])

    encode = (lambda x: {"x": x}) if path.suffix == ".npz" else (lambda x: x.tolist())
    decode = (lambda content: content["x"]) if path.suffix == ".npz" else np.array
    return Job(path=path, kind="numbers", version=1, key=lambda: key, compute=compute, encode=encode, decode=decode,
               optional=optional)  # fmt: skip


@pytest.mark.parametrize("name", ["x.json", "x.npz"])
def test_a_result_is_computed_once_per_key(tmp_path, name):
    path, computed, lines = tmp_path / "folder" / name, [], []
    np.testing.assert_array_equal(job(path, computed=computed).result(1.0, on_rejected=lines.append), [1.0, 2.0])
    np.testing.assert_array_equal(job(path, computed=computed).result(5.0, on_rejected=lines.append), [1.0, 2.0])
    assert (computed, lines) == ([1.0], [])
    np.testing.assert_array_equal(job(path, "b", computed).result(3.0, on_rejected=lines.append), [3.0, 2.0])
    path.write_bytes(path.read_bytes()[:-20])
    job(path, "b", computed).result(4.0, on_rejected=lines.append)
    assert computed == [1.0, 3.0, 4.0]
    assert [str(path) in line for line in lines] == [True, True]


def test_an_interrupted_computation_leaves_no_result(tmp_path):
    def interrupt(*_):
        raise KeyboardInterrupt

    path = tmp_path / "x.json"
    job(path).result(1.0)
    stopped = Job(**{**vars(job(path, "b")), "compute": interrupt})
    with pytest.raises(KeyboardInterrupt):
        stopped.result()
    assert not path.exists()


def test_only_an_optional_file_may_fail_to_be_written(tmp_path):
    (tmp_path / "file").write_text("")
    path = tmp_path / "file" / "x.json"
    with pytest.warns(UserWarning, match="not kept"):
        np.testing.assert_array_equal(job(path, optional=True).result(1.0), [1.0, 2.0])
    with pytest.raises(OSError, match="file"):
        job(path).result(1.0)
