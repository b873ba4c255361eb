"""The loop of a robot at a fixed rate: predict, decide, move, detect, update.

    python examples/robot_loop.py best --steps 60 --speed 20

`Robot` is a simulated one: put your own driver and detector in its place. What it needs to know of a target is an id
and a position in its own frame, whenever it sees one.
"""

import argparse
import time
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from foveate.deploy.tracker import Tracker
from foveate.experiment.resolve import load
from foveate.geometry.numpy_poses import placed
from foveate.models.problem import Problem

MOST = 16
"""The decision is compiled once, for so many targets."""


class Robot:
    """A stand-in: moves exactly as told among targets that wander, and sees those in its view, with noise."""

    def __init__(self, problem: Problem, seed: int) -> None:
        self.problem, self.rng = problem, np.random.default_rng(seed)
        space = problem.agent.space
        self.pose = np.asarray(space.upright(jnp.zeros(space.dimension), jnp.zeros(())))
        self.state = np.zeros((5, problem.motion.state_size))
        self.state[:, : space.dimension] = self.rng.uniform(-5, 5, (5, space.dimension))
        self._move = jax.jit(lambda pose, action: problem.agent.move(pose, action, problem.tau))
        self._sees = jax.jit(lambda pose, points: problem.sensor.view.contains(space.to_body(pose, points)))
        self._body = jax.jit(lambda pose, points: space.to_body(pose, points))
        self._move(self.pose, np.zeros(len(problem.agent.axes)))
        self.detect()  # all is compiled before the clock runs

    def rough_positions(self) -> dict[str, np.ndarray]:
        """Where somebody said that targets were, some metres off."""
        position = self.state @ np.asarray(self.problem.motion.Z).T
        return {f"target {i}": p for i, p in enumerate(position + self.rng.normal(0, 1, position.shape))}

    def move(self, action: np.ndarray) -> None:
        """Carry out a command for one period, while the targets move too."""
        motion = self.problem.motion
        self.pose = np.asarray(self._move(self.pose, action))
        push = self.rng.multivariate_normal(np.zeros(len(motion.W)), motion.W, len(self.state))
        self.state = self.state @ np.asarray(motion.A).T + push

    def detect(self) -> dict[str, np.ndarray]:
        """Measured positions in the body frame, of the targets in view."""
        position = self.state @ np.asarray(self.problem.motion.Z).T
        noisy = position + self.rng.multivariate_normal(
            np.zeros(position.shape[1]), self.problem.sensor.V, len(position)
        )
        seen, body = self._sees(self.pose, position), np.asarray(self._body(self.pose, noisy))
        return {f"target {i}": body[i] for i in np.flatnonzero(seen)}


def main() -> None:
    """Drive for a while, and say each step what was seen and how well the targets are known."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("run", help="run folder of foveate train, or a preset")
    options.add_argument("--steps", type=int, default=60)
    options.add_argument("--speed", type=float, default=1.0, help="of the clock, for a look: 20 is 20 times as fast")
    options.add_argument("--seed", type=int, default=0)
    given = options.parse_args()

    experiment, policy, _ = load(given.run)
    problem = experiment.scenario.problem()
    decide = eqx.filter_jit(lambda observation: policy(observation, (), jax.random.key(0))[0])
    robot, tracker = Robot(problem, given.seed), Tracker(problem, forget_after_s=30.0)
    for name, position in robot.rough_positions().items():
        tracker.add(name, position)
    # The robot goes on and on: at every step as many are left as there were in the middle of a training episode.
    look = partial(tracker.observation, steps_left=experiment.scenario.scenes.middle_steps_left, pad_to=MOST)
    decide(look(robot.pose))  # compiled before the robot moves

    Z = np.asarray(problem.motion.Z)
    period, late = float(problem.tau) / given.speed, 0
    due = time.monotonic()
    for step in range(given.steps):
        dropped = tracker.predict()
        action = np.asarray(decide(look(robot.pose)))
        robot.move(action)
        due += period
        late += time.monotonic() > due
        time.sleep(max(0.0, due - time.monotonic()))
        detections = {name: placed(robot.pose, point) for name, point in robot.detect().items()}
        seen = tracker.update(robot.pose, detections)
        spread = np.sqrt(np.einsum("ij,njk,ik->n", Z, tracker.covariance, Z)).max(initial=0.0)
        command = ", ".join(f"{value:+.2f}" for value in np.asarray(problem.agent.control(jnp.asarray(action))))
        told = f"step {step + 1}: command {command}; saw {len(seen.updated)} of {len(tracker.ids)}"
        print(f"{told}, least known to {spread:.2f} m" + f"; dropped {dropped}" * bool(dropped))
    print(f"{late} of {given.steps} steps were late; {sum(tracker.rejected.values())} detections rejected")


if __name__ == "__main__":
    main()
