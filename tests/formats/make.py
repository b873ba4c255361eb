"""Writes the example of each format beside it, by the version of foveate that runs: done once a version of a format.

    python tests/formats/make.py

The examples that are here were written by foveate 0.1.0, those of formats and versions that it did not have by 0.2.0. A
later version must read them: where it cannot, the format's version goes up, and an example of the new one joins them.
"""

import json
from pathlib import Path

import jax
import numpy as np

from foveate.evaluation.evaluate import evaluate, prepare
from foveate.evaluation.summary import VERSION as EVALUATION
from foveate.evaluation.summary import summarise, write_result
from foveate.evaluation.verdict import verdict_of, write_verdict
from foveate.experiment.checkpoint import load_run
from foveate.experiment.experiment import Experiment
from foveate.experiment.learners import ActorCriticSettings
from foveate.experiment.presets import PRESETS, TrainingSettings
from foveate.experiment.run_folder import BEST, EXTENDED, LAST
from foveate.io.files import write_document
from foveate.io.toml import digest, save_toml
from foveate.learning.train import train
from foveate.models.robot import Robot
from foveate.planning.named import heuristic_policy
from foveate.policies.attention import AttentionSettings
from foveate.policies.pointer_settings import PointerSettings
from foveate.recordings.formats import load_recording
from foveate.recordings.replay import VERSION, drive, prepare_replay, result
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import Scene, SceneSettings, write_scenes
from foveate.simulation.records import PROTOCOLS, observe
from foveate.simulation.step import predict, start

HERE = Path(__file__).parent
SCENES = SceneSettings(targets_min=1, targets_max=2, steps=4, drift_m_s=(0.1, 0.1))
RUNS = {
    "policy-gradient": Experiment(
        scenario=Scenario(scenes=SCENES),
        policy=AttentionSettings(agent_widths=(4,), target_widths=(8, 4), out_widths=(6,)),
        training=TrainingSettings(epochs=4, episodes=4, held_out=4, check_every=2),
    ),
    "actor-critic": Experiment(
        scenario=Scenario(scenes=SCENES),
        policy=PointerSettings(kind="pointer", target_widths=(8, 8), heads=2, context_widths=(8,), modes=1),
        training=ActorCriticSettings(
            algorithm="actor-critic", epochs=4, episodes=4, minibatches=2, held_out=4, check_every=2
        ),
    ),
}
TWO = Scene(
    id="two", agent=(0.0, 0.5, 0.1), targets=((1.0, 1.0), (-3.0, 0.5)), drift=((0.1, 0.0), (0.0, 0.0)), horizon=4
)
NONE = Scene(id="none", agent=(1.0, 2.0, 3.0), targets=(), drift=(), horizon=3)
SCORES = {"policy": np.array([2.0, 3.0, 1.5]), "still": np.array([0.5, 1.0, -0.5])}
RECORDING = "time_s,track_id,x_m,y_m\n0,a,0,0\n0,b,5,1\n0.5,a,0.4,0.1\n1.25,b,4,1\n2,a,2,0\n3,a,2.5,0.25\n"


def decision(run: Path) -> list[float]:
    """Decision of a run's policy at the beginning of the first scene."""
    experiment, policy, _ = load_run(run)
    problem = experiment.scenario.problem()
    episode = jax.tree.map(lambda x: x[0], prepare(problem, experiment.scenario.scenes, [TWO]).episodes)
    first = jax.tree.map(lambda x: x[0], episode.inputs)
    seen = observe(
        predict(problem, start(problem, episode, PROTOCOLS["true"]), first), first, episode.horizon, Robot.of(problem)
    )
    action, _ = policy(seen, policy.start(seen), jax.random.key(0))
    return np.asarray(action, float).tolist()


def main() -> None:
    """Write all."""
    decisions = {}
    for name, experiment in RUNS.items():
        train(experiment, HERE / name, seed=1)
        for left in [*(HERE / name).glob("events*"), HERE / name / ".lock"]:
            left.unlink()
        decisions[name] = decision(HERE / name)
    (HERE / "actor-critic" / LAST).unlink()  # its critic is as large as any
    (HERE / "decisions.json").write_text(json.dumps(decisions, indent=1) + "\n")
    for name, preset in PRESETS.items():
        save_toml(preset, HERE / f"preset-{name}.toml", "A preset, as it was")
    write_scenes(HERE / "scenes.json", [TWO, NONE])
    (HERE / "recording.csv").write_text(RECORDING)
    recording = load_recording(HERE / "recording.csv")
    (HERE / "recording.csv.sha256").write_text(f"{recording.sha256}  recording.csv\n")

    experiment = Experiment()
    problem = experiment.scenario.problem()
    still = heuristic_policy("still", problem, 2.0)
    suite = prepare(problem, experiment.scenario.scenes, [TWO, NONE], objective=experiment.training.objective)
    rows = evaluate(suite, "still", still, ("surrogate", "true"))
    facts = {"run": "paper", "scenes": "scenes.json", "experiment": digest(experiment), "seed": 0}
    write_result(HERE / f"evaluation-{EVALUATION}.json", rows, summarise(rows, 2), facts)
    write_document(HERE / EXTENDED, "extension", 1, {"experiments": [digest(experiment)]})
    write_verdict(HERE, verdict_of(experiment, SCORES, {"icr-16": np.array([2.5, 3.5])}))
    row, _ = drive(prepare_replay(experiment.scenario, recording, [0.0, 0.0, 0.0]), "still", still)
    facts = {"run": "paper", "recording": "recording.csv", "seed": 0}
    write_document(HERE / "replay.json", "replay", VERSION, result([row], experiment, recording, facts))
    assert all((HERE / name / BEST).exists() for name in RUNS)


if __name__ == "__main__":
    main()
