"""Sensor and clock faults have a defined outcome: outliers, jumps of the clock, targets that flicker, nothing seen.

Numbers that are not finite in training and collapsed policies: learning/test_training.py. Rejected measurements:
models/test_gate.py. Files that are cut or damaged: test_formats.py. Killed processes: learning/test_killed.py.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import pytest

from foveate.deploy.tracker import Tracker
from foveate.experiment.presets import TrainingSettings
from foveate.learning.policy_gradient import begin, optimizer
from foveate.models.belief import predict_information
from foveate.planning.named import heuristic_policy
from foveate.policies.attention import AttentionSettings
from foveate.recordings.formats import load_recording
from foveate.recordings.plausibility import warnings_for
from foveate.recordings.replay import drive, prepare_replay
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import SensorSettings
from foveate.scenario.target import DriftTarget
from foveate.simulation.records import PROTOCOLS, SURROGATE, Episode, Truth
from foveate.simulation.rollout import log_dets, rollout

WIDE = Scenario(
    tau_s=0.5,
    view=SectorView(depth_m=100.0, angle_deg=360.0),
    sensor=SensorSettings(std_m=0.1),
    target=DriftTarget(process_std_m=0.1),
    scenes=SceneSettings(initial_error="consistent", targets_max=3, known_drift=False),
)


def recorded(path, rows):
    path.write_text("time_s,track_id,x_m,y_m\n" + "".join(",".join(map(str, row)) + "\n" for row in rows))
    return load_recording(path)


def driven(recording, **options):
    ready = prepare_replay(WIDE, recording, [0.0, 0.0, 0.0], **options)
    return drive(ready, "still", heuristic_policy("still", ready.problem, 100.0))


def test_outliers_of_100_sigma_in_a_recording_are_rejected_and_counted(tmp_path):
    sigma = 0.1 * np.sqrt(2)
    rows = [(0.5 * k, name, 3.0 + 100 * sigma * (k in wild), 1.0) for k in range(41) for name, wild in TRACKS.items()]
    row, trace = driven(recorded(tmp_path / "r.csv", rows))
    assert row.rejected == sum(map(len, TRACKS.values()))
    assert row.seen_time_fraction == pytest.approx(1 - row.rejected / 80)
    assert np.abs(trace.mean - [3.0, 1.0]).max(axis=(1, 2))[3:].max() < 1.0
    free, pulled = driven(recorded(tmp_path / "again.csv", rows), gate=None)
    assert free.rejected == 0
    assert np.abs(pulled.mean - [3.0, 1.0]).max(axis=(1, 2))[3:].max() > 5.0


TRACKS = {"a": {10, 20}, "b": {15, 16}}


def test_a_clock_that_jumps_ahead_is_warned_of_and_back_is_rejected(tmp_path):
    times = [*np.arange(0, 10, 0.5), *np.arange(3600, 3610, 0.5)]
    recording = recorded(tmp_path / "r.csv", [(t, "a", 1.0, 1.0) for t in times])
    ready = prepare_replay(WIDE, recording, [0.0, 0.0, 0.0])
    (said,) = [line for line in warnings_for(WIDE, recording, ready.slots, 2.0) if "clock" in line]
    assert said.startswith("nothing is recorded between 9.5 s and 3600 s")
    row, trace = driven(recording)
    assert np.isfinite(trace.mean).all()
    assert row.rmse_m < 1.0, "all that time nobody was there: it does not count"
    even = recorded(tmp_path / "even.csv", [(t, "a", 1.0, 1.0) for t in np.arange(0, 10, 0.5)])
    assert not [line for line in warnings_for(WIDE, even, ready.slots, 2.0) if "clock" in line]
    with pytest.raises(ValueError, match=r"line 4: time_s 0\.5 comes after 1\.0; rows must be sorted by time"):
        recorded(tmp_path / "back.csv", [(0.0, "a", 1, 1), (1.0, "a", 1, 1), (0.5, "a", 1, 1)])
    with pytest.raises(ValueError, match="look for wrong times in it"):
        driven(recorded(tmp_path / "far.csv", [(0.0, "a", 1, 1), (1e9, "a", 1, 1)]))


@pytest.mark.slow
def test_targets_that_appear_and_leave_at_every_step(tmp_path):
    rows = [(0.5 * k, f"t{k}-{j}", 2.0 + j, float(j)) for k in range(60) for j in range(k % 3)]
    rows += [(0.5 * k, "always", 1.0, 1.0) for k in range(60)]
    rows.sort(key=lambda row: row[0])
    row, trace = driven(recorded(tmp_path / "r.csv", rows))
    assert row.targets == 1, "the others are never there for a step"
    assert np.isfinite(trace.mean).all()
    assert np.isfinite(trace.log_det).all()
    tracker, pose = Tracker(WIDE, forget_after_s=0.5), np.zeros(3)
    for k in range(60):
        tracker.predict()
        tracker.update(pose, {(k, j): [2.0 + j, j] for j in range(k % 5)})
        assert len(tracker.ids) <= 8, "of this step and of the one before"
        assert (np.linalg.eigvalsh(tracker.covariance) > 0).all()


def episode_of(steps, positions, truth=None):
    n = len(positions)
    return Episode(
        pose=jnp.zeros(3),
        mean=jnp.asarray(positions, float).reshape(n, 2),
        present=jnp.ones(n, bool),
        inputs=jnp.zeros((steps, n, 2)),
        horizon=jnp.asarray(steps),
        truth=truth,
    )


@pytest.mark.slow
def test_all_targets_unseen_for_ten_thousand_steps():
    """log det falls as a random walk's does, in float32 too."""
    problem = Scenario().problem()
    still, steps = heuristic_policy("still", problem, 2.0), 10_000
    truth = Truth(jnp.full((steps + 1, 2, 2), -50.0), jnp.zeros((steps, 2, 2)))
    episode = episode_of(steps, [[-50.0, -50.0], [-80.0, 0.0]], truth)
    trace = jax.jit(lambda: rollout(problem, still, episode, PROTOCOLS["true"], jax.random.key(0)))()
    assert not trace.visible.any()
    expected = -2 * np.log(2.0 + 0.05**2 * np.arange(1, steps + 1))
    np.testing.assert_allclose(trace.log_det[:, 0], expected, atol=1e-8)
    assert jnp.isfinite(trace.action).all()
    first, motion = (jax.tree.map(lambda x: x.astype(jnp.float32), y) for y in (jnp.eye(2) / 2, problem.motion))
    ahead = jax.jit(lambda Y: jax.lax.fori_loop(0, steps, lambda _, Y: predict_information(Y, motion), Y))
    np.testing.assert_allclose(ahead(first), np.eye(2) / (2.0 + 0.05**2 * steps), rtol=1e-3, atol=1e-6)


def test_a_target_at_the_apex_has_a_finite_and_right_gradient():
    """Exactly where the agent stands: range 0, a corner of the view."""
    problem = Scenario(sensor=SensorSettings(range_growth_per_m=0.1)).problem()
    policy = AttentionSettings(agent_widths=(4,), target_widths=(4,), out_widths=(4,)).policy(
        problem, jax.random.key(0)
    )
    arrays, static = eqx.partition(policy, eqx.is_inexact_array)
    episode = episode_of(3, [[0.0, 0.0], [1.0, 0.5]])

    @jax.jit
    @jax.value_and_grad
    def score(arrays):
        return jnp.sum(log_dets(problem, eqx.combine(arrays, static), episode, SURROGATE, jax.random.key(1))[-1])

    _, gradient = score(arrays)
    norm = optax.tree.norm(gradient)
    assert 0 < float(norm) < 1e3
    step = jax.tree.map(lambda g: 1e-6 * g / norm, gradient)
    ahead, behind = (score(jax.tree.map(lambda a, s, sign=sign: a + sign * s, arrays, step))[0] for sign in (1, -1))
    np.testing.assert_allclose((ahead - behind) / 2e-6, norm, rtol=1e-4)


def test_a_step_is_bounded_however_the_gradient_explodes():
    settings = TrainingSettings(learning_rate=1e-3)
    problem = Scenario().problem()
    policy = AttentionSettings(agent_widths=(4,), target_widths=(4,), out_widths=(4,)).policy(
        problem, jax.random.key(0)
    )
    parameters = eqx.filter(policy, eqx.is_inexact_array)
    state, update = begin(policy, settings).optimizer, jax.jit(optimizer(settings).update)
    for size in (1.0, 1e6, 1e30, 1e150):
        gradient = jax.tree.map(lambda x, s=size: jnp.full_like(x, s), parameters)
        updates, state = update(gradient, state, parameters)
        assert max(float(jnp.abs(x).max()) for x in jax.tree.leaves(updates)) <= 1.5e-3
