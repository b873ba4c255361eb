"""Episodes as training draws them, by one compiled program in place of a hundred operations compiled one by one."""

import equinox as eqx

from foveate.simulation import episodes

training_episode = eqx.filter_jit(episodes.training_episode)
