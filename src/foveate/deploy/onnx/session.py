"""An exported file opened by onnxruntime: its scenario, its inputs, and its decisions."""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float

from foveate.deploy.onnx.export import FORMAT, NO_DIGEST, VERSION
from foveate.errors import InputError
from foveate.io.files import read_bytes
from foveate.io.records import from_table
from foveate.names import OBJECTIVES, Objective
from foveate.scenario.scenario import Scenario


@dataclass(frozen=True, kw_only=True, eq=False)
class Session:
    """A file of `foveate export`, opened; `wanted` are its inputs by name, with their shapes for one decision.

    `rays`: number of rays along which its policy is told free ranges; `facts` are its metadata.
    """

    path: str
    facts: dict[str, str]
    scenario: Scenario
    wanted: dict[str, tuple[str | int, ...]]
    run: Any

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of a command's numbers."""
        return tuple(json.loads(self.facts["output"])["axes"])

    @property
    def objective(self) -> Objective | None:
        """What a pointer network was trained for; None for others, and in files of foveate 0.1."""
        told = self.facts.get("objective") if self.facts["policy"] == "pointer" else None
        return next((each for each in OBJECTIVES if each == told), None)

    @property
    def rays(self) -> int:
        """Number of rays of the policy; 0 for one that knows of no obstacles."""
        return len(json.loads(self.facts["rays"])["directions"]) if "rays" in self.facts else 0

    def commands(self, arrays: Mapping[str, np.ndarray]) -> Float[np.ndarray, "b m"]:
        """The commands of b decisions [m/s, rad/s] from arrays by the names of the inputs, others of them ignored."""
        return self.run(["control"], {name: arrays[name] for name in self.wanted})[0]


def open_file(path: str) -> Session:
    """Open a file of `foveate export`.

    Raises InputError without onnxruntime, for another file, one without its scenario, as foveate 0.1 wrote it, and one
    of which a byte was changed.
    """
    try:
        import onnxruntime
    except ImportError as error:
        raise InputError(f"{path}: needs onnxruntime ({error}): pip install onnxruntime") from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # a network this small is slower on several threads
    data = read_bytes(path, "ONNX file")
    try:
        session = onnxruntime.InferenceSession(data, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime has an exception of its own for everything
        raise InputError(f"{path}: is no ONNX file: {str(error)[:200]}") from None
    facts = session.get_modelmeta().custom_metadata_map
    if (facts.get("format"), facts.get("format_version")) != (FORMAT, str(VERSION)) or "scenario" not in facts:
        raise InputError(f"{path}: has no scenario in it: expected a file of foveate export by this version or a later")
    before, said, after = data.rpartition(facts.get("sha256", "").encode())
    if hashlib.sha256(before + NO_DIGEST.encode() + after).hexdigest().encode() != said:
        raise InputError(f"{path}: is damaged or was changed: it does not fit its digest; export it again")
    return Session(
        path=path,
        facts=facts,
        scenario=from_table(Scenario, json.loads(facts["scenario"]), path),
        wanted={each.name: tuple(each.shape[1:]) for each in session.get_inputs()},
        run=session.run,
    )
