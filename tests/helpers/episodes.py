"""Episodes as training draws them, and played, by one compiled program each in place of hundreds of operations."""

import equinox as eqx

from foveate.simulation import episodes
from foveate.simulation import rollout as rollouts

training_episode = eqx.filter_jit(episodes.training_episode)
rollout = eqx.filter_jit(rollouts.rollout)
