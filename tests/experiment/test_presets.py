"""Experiments that change their learner: what is after stays, and the network is one that the learner can train."""

from dataclasses import replace

import pytest

from foveate.cli.main import main
from foveate.experiment.experiment import Experiment, with_learner
from foveate.experiment.learners import ActorCriticSettings, PPOSettings, TrainingSettings
from foveate.experiment.presets import PPO, PRESETS
from foveate.io.toml import load_toml
from foveate.learning.loop import train
from foveate.policies.attention import AttentionSettings
from foveate.policies.pointer_settings import PointerSettings
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.scenario import Scenario

ACTOR_CRITIC = ActorCriticSettings(algorithm="actor-critic")
STREET = Experiment(
    scenario=Scenario(view=SectorView(shape="sector", depth_m=8.0, angle_deg=90.0)),
    policy=AttentionSettings(length_m=8.0),
    training=TrainingSettings(objective="seen", select="true", held_out=7, softness=((1.0, 2.0),), noise=True),
)


def test_a_learner_brings_a_network_that_it_can_train():
    experiment = with_learner(STREET, ACTOR_CRITIC)
    assert experiment.training == replace(ACTOR_CRITIC, objective="seen", select="true", held_out=7)
    assert experiment.policy == PointerSettings(kind="pointer")
    assert experiment.scenario == STREET.scenario
    back = with_learner(experiment, TrainingSettings())
    assert back.training == TrainingSettings(objective="seen", select="true", held_out=7)
    assert back.policy == AttentionSettings()
    assert with_learner(STREET, TrainingSettings()).policy == STREET.policy
    with pytest.raises(ValueError, match="expected 'terminal'"):
        with_learner(experiment, PPO["ppo"])


def test_the_policy_gradient_rejects_a_network_of_modes(tmp_path):
    with pytest.raises(ValueError, match="actor-critic"):
        train(Experiment(policy=PointerSettings(kind="pointer")), tmp_path / "run")
    assert not (tmp_path / "run").exists()


def test_two_experiments_at_once_are_rejected(tmp_path, capsys):
    config = tmp_path / "own.toml"
    config.write_text("")
    assert main(["train", "--preset", "best", "--config", str(config), "--out", str(tmp_path / "a")]) == 2
    assert "give one of them" in capsys.readouterr().err
    assert main(["train", "--preset", "best", "--resume", str(tmp_path)]) == 2
    assert "--preset and --resume" in capsys.readouterr().err


def test_actor_critic_presets_have_a_network_with_modes():
    for experiment in PRESETS.values():
        assert isinstance(experiment.training, ActorCriticSettings) == isinstance(experiment.policy, PointerSettings)


@pytest.mark.parametrize("algorithm", ["ppo", "actor-critic"])
def test_the_former_name_of_update_epochs_is_still_read(algorithm: str, tmp_path):
    policy = 'kind = "pointer"' if algorithm == "actor-critic" else ""
    (tmp_path / "old.toml").write_text(f'[policy]\n{policy}\n[training]\nalgorithm = "{algorithm}"\npasses = 3\n')
    training = load_toml(Experiment, tmp_path / "old.toml").training
    assert isinstance(training, PPOSettings | ActorCriticSettings)
    assert training.update_epochs == 3
