"""Inputs of a policy from the beliefs of any tracker of foveate."""

import abc

import numpy as np
from numpy.typing import ArrayLike

from foveate.deploy.belief import Belief, observation
from foveate.deploy.pose import QuaternionOrder, checked_pose
from foveate.models.problem import Problem
from foveate.simulation.records import Observation


class Observing(abc.ABC):
    """A tracker that decides nothing, but gives a policy its inputs; `step` is the number of its predictions."""

    _problem: Problem
    step: int

    @abc.abstractmethod
    def belief(self) -> Belief:
        """Belief at the current step; after `predict`, the input of a policy."""

    def inputs(
        self, pose: ArrayLike, steps_left: int, pad_to: int = 0, *, quaternion: QuaternionOrder = "wxyz"
    ) -> dict[str, np.ndarray]:
        """Inputs of an exported policy by name, for one decision, padded to at least `pad_to` targets.

        Some policies read only some of them. A robot without an end gives the `steps_left` of the middle of a training
        episode every time: with many more a policy may postpone everything for ever.
        """
        observation = self.observation(pose, steps_left, pad_to, quaternion=quaternion)
        names = ("pose", "mean", "information", "known_input")
        inputs = {name: np.asarray(getattr(observation, name), np.float32)[None] for name in names}
        counts = {"steps_left": np.array([int(steps_left)]), "step": np.asarray(observation.step, np.int64)[None]}
        return {**inputs, "present": np.asarray(observation.present)[None], **counts}

    def observation(
        self, pose: ArrayLike, steps_left: int, pad_to: int = 0, *, quaternion: QuaternionOrder = "wxyz"
    ) -> Observation:
        """Observation of a policy in JAX, padded to at least `pad_to` targets: one compilation while these suffice."""
        step = max(0, self.step - 1)
        here = checked_pose(pose, self._problem.motion.dimension, quaternion)
        return observation(self.belief(), self._problem, here, steps_left, pad_to, step)
