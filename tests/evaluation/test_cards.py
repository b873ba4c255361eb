"""Model cards against the files of the package, read without foveate."""

import json
import tomllib

import numpy as np
import pytest

from foveate.errors import InputError
from foveate.evaluation.cards import cards, cards_table, facts
from foveate.experiment.resolve import TRAINED


def test_every_preset_has_a_card_of_what_its_files_say():
    found = {card.name: card for card in cards()}
    assert set(found) == {path.name for path in TRAINED.iterdir()} >= {"paper", "true-view"}
    for name, card in found.items():
        table = tomllib.loads((TRAINED / name / "config.toml").read_text(encoding="utf-8"))
        record = json.loads((TRAINED / name / "record.json").read_text(encoding="utf-8"))
        with np.load(TRAINED / name / "checkpoint" / "best.npz") as arrays:
            weights = sum(arrays[key].size for key in arrays.files if key != "header")
        scenes, words = table["scenario"]["scenes"], facts(card)
        assert (card.targets_min, card.targets_max) == (scenes["targets_min"], scenes["targets_max"])
        assert card.weights == weights
        assert f"{weights:,} weights" in words["Size"]
        assert card.size_bytes == (TRAINED / name / "checkpoint" / "best.npz").stat().st_size
        assert (card.held_out, card.iterations, card.seed) == (record["held_out"], record["epoch"], record["seed"])
        assert words["Score"].startswith(f"{record['held_out']:.2f}: ")
        assert f"{table['training']['select']} protocol" in words["Score"]
        assert card.robot.startswith(table["scenario"]["agent"]["kind"])
        assert card.view.startswith(table["scenario"]["view"]["shape"])
        among = table["scenario"].get("obstacles", {}).get("kind", "")
        assert words.get("Obstacles", "").partition(" ")[0] == among
        assert ("obstacles that hide targets" in words["Limits"]) == (name in ("rooms", "forest")) == (among != "")
        assert words["Licence"].startswith("Apache-2.0")
        file = TRAINED / name / "verdict.json"
        rows = json.loads(file.read_text(encoding="utf-8"))["rows"] if file.exists() else []
        best = {row["kind"]: (row["method"], row["mean"]) for row in sorted(rows, key=lambda row: row["mean"])}
        for method, mean in best.values():
            assert f"{method} {mean:.2f}" in words["Verdict"]


def test_cards_of_named_presets():
    (card,) = cards(["quadrotor"])
    assert "initial_velocity_variance_m2_s2 0.16" in card.targets
    assert card.steps == "30 steps of 0.5 s"
    assert cards_table([card]).rows == (("quadrotor", "quadrotor", "frustum", "3-8", "true mean score", "11.77"),)
    with pytest.raises(InputError, match="true-vieww: no such preset; did you mean true-view"):
        cards(["true-vieww"])
