"""Two kills of PPO, as `make kill` does twenty; and that it would notice what a kill must not leave."""

from dataclasses import replace

import jax
import numpy as np
import pytest
from endurance.kill import PPO, kill_ppo, remains

from foveate.experiment.checkpoint import save_tree, write_config
from foveate.experiment.run_folder import BEST, METRICS


@pytest.mark.exhaustive
@pytest.mark.slow
@pytest.mark.torch
def test_a_killed_ppo_leaves_a_part_of_what_it_would_have_left(tmp_path):
    pytest.importorskip("stable_baselines3", reason="needs the extra ppo")
    short = replace(PPO, training=replace(PPO.training, steps=4000))
    kills, wrong = kill_ppo(short, 2, np.random.default_rng(1), tmp_path)
    assert wrong == []
    assert len(kills.at) == 2


@pytest.mark.slow
def test_what_a_kill_must_not_leave_is_noticed(tmp_path):
    (tmp_path / BEST).parent.mkdir()
    write_config(tmp_path, PPO)
    policy = PPO.new_policy(jax.random.key(0), PPO.scenario.problem())
    rows = [{"epoch": 1, "best": True}, {"epoch": 2, "best": False}, {"epoch": 3, "best": True}]

    def left(text, epoch):
        (tmp_path / METRICS).write_text(text)
        save_tree(tmp_path / BEST, policy, PPO, "policy", {"epoch": epoch})
        return remains(PPO, tmp_path, rows)

    two = '{"epoch": 1, "best": true, "elapsed_s": 3}\n{"epoch": 2, "best": false}\n'
    assert left(two, 1) == []
    assert left(two, 3) == [], "its best is written before its line"
    assert left(f'{two}{{"epoch": 3, "be', 3) == [], "a line that was cut"
    assert left(two, 2) == ["not its best policy"]
    assert left(two.replace("2", "4"), 1) == ["other validations than of a training left alone"]
