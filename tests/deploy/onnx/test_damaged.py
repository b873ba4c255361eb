"""ONNX files that were damaged, or made by hand, are refused in one line by the example that robots copy."""

import json
import runpy
from pathlib import Path

import jax
import numpy as np
import pytest

from foveate.deploy.onnx.export import sealed, to_onnx
from foveate.experiment.experiment import Experiment
from foveate.policies.attention import AttentionSettings

onnxruntime = pytest.importorskip("onnxruntime", reason="needs the extra onnx")
onnx = pytest.importorskip("onnx", reason="needs the extra onnx")

EXAMPLE = runpy.run_path(str(Path(__file__).parents[3] / "examples" / "run_onnx.py"))["OnnxPolicy"]
MODEL = {"steps": [{"A": [[1.0]], "B": [[1.0]], "W": [[1.0]]}], "Z": [[1.0]]}
FACTS = {"format": "foveate-policy", "format_version": "1", "output": "{}", "model": json.dumps(MODEL)}


def made(facts, weights=None):
    """A model that copies its input, or adds weights to it, with these metadata."""
    helper, kind = onnx.helper, onnx.TensorProto.FLOAT
    ends = [helper.make_tensor_value_info(name, kind, [1]) for name in ("pose", "control")]
    copied = helper.make_node("Identity", ["pose"], ["control"])
    node = copied if weights is None else helper.make_node("Add", ["pose", weights.name], ["control"])
    graph = helper.make_graph([node], "g", ends[:1], ends[1:], [] if weights is None else [weights])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    helper.set_model_props(model, facts)
    return model


@pytest.fixture(scope="module")
def whole():
    """The bytes of an exported policy."""
    settings = AttentionSettings(agent_widths=(4,), target_widths=(8, 4), out_widths=(6,))
    experiment = Experiment(policy=settings)
    return sealed(to_onnx(experiment, settings.policy(experiment.scenario.problem(), jax.random.key(0))))


def refused(path, data):
    """The one line with which a file is refused."""
    path.write_bytes(data)
    with pytest.raises(ValueError, match=f"^{path}: ") as caught:
        EXAMPLE(str(path))
    assert len(str(caught.value).splitlines()) == 1
    return str(caught.value)


def test_any_changed_byte_is_noticed(whole, tmp_path):
    rng = np.random.default_rng(0)
    (tmp_path / "x.onnx").write_bytes(whole)
    assert EXAMPLE(str(tmp_path / "x.onnx")).wanted == ["pose", "mean", "information", "present"]
    for _ in range(300):
        place, bit = int(rng.integers(len(whole))), 1 << int(rng.integers(8))
        assert "damaged" in refused(
            tmp_path / "x.onnx", whole[:place] + bytes([whole[place] ^ bit]) + whole[place + 1 :]
        )
    for end in (0, 1, 100, len(whole) // 2, len(whole) - 1):
        assert "damaged" in refused(tmp_path / "x.onnx", whole[:end])
    assert "damaged" in refused(tmp_path / "x.onnx", whole + whole[:10])


def outside(location):
    """A tensor whose numbers are in another file."""
    tensor = onnx.TensorProto(name="w", data_type=onnx.TensorProto.FLOAT, dims=[4], data_location=1)
    tensor.external_data.add(key="location", value=location)
    return tensor


@pytest.mark.parametrize(
    ("model", "why"),
    [
        (made({}), "not a foveate-policy of version 1"),
        (made({**FACTS, "format_version": "2"}), "not a foveate-policy of version 1"),
        (made({**FACTS, "output": "{'a'"}), "Expecting"),
        (made({**FACTS, "model": "[" * 100_000}), "recursion"),
        (made({k: v for k, v in FACTS.items() if k != "model"}), "model"),
        (made(FACTS, outside("/etc/passwd")), ""),
        (made(FACTS, outside("../../../../etc/passwd")), ""),
        (made(FACTS, onnx.TensorProto(name="w", data_type=1, dims=[1 << 40])), ""),
    ],
    ids=["foreign", "later", "json", "deep", "missing", "outside", "above", "huge"],
)
def test_models_made_by_hand_with_a_right_digest_are_refused(model, why, tmp_path):
    assert why in refused(tmp_path / "x.onnx", sealed(model))


def test_a_model_made_by_hand_is_taken_where_it_is_whole(tmp_path):
    (tmp_path / "x.onnx").write_bytes(sealed(made(FACTS)))
    assert EXAMPLE(str(tmp_path / "x.onnx")).wanted == ["pose"]
