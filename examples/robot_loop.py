"""Control loop of a robot at a fixed rate: predict, decide, move, detect, update.

    python examples/robot_loop.py best --steps 60 --speed 20

`Robot` is simulated: replace it by your own driver and detector. The detector has to give an id and a position in the
robot's frame for every target that it sees.
"""

import argparse
import time

import jax
import jax.numpy as jnp
import numpy as np

import foveate

MAX_TARGETS = 16
"""Beliefs are padded to this number of targets, so that the policy is compiled once."""


class Robot:
    """Simulated robot: moves exactly as commanded among wandering targets, and measures those in view, with noise."""

    def __init__(self, problem: foveate.Problem, seed: int) -> None:
        self.problem, self.rng = problem, np.random.default_rng(seed)
        space, agent = problem.agent.space, problem.agent
        self.pose = np.asarray(space.upright(jnp.zeros(space.dimension), jnp.zeros(())))
        self.state = np.zeros((5, problem.motion.state_size))
        self.state[:, : space.dimension] = self.rng.uniform(-5, 5, (5, space.dimension))
        self._move = jax.jit(lambda pose, command: agent.move(pose, agent.action(command), problem.tau))
        self._sees = jax.jit(lambda pose, points: problem.sensor.view.contains(space.to_body(pose, points)))
        self._to_body, self._to_world = jax.jit(space.to_body), jax.jit(space.to_world)
        self._move(self.pose, np.zeros(len(agent.axes)))
        self.detect()  # compiles everything before the clock starts

    def rough_positions(self) -> dict[str, np.ndarray]:
        """Return prior positions of the targets, some 0.2 m off on each axis, as the presets were trained.

        Further off the robot may look in vain where a target is believed to be: the preset `search` was trained for it.
        """
        position = self.state @ np.asarray(self.problem.motion.Z).T
        return {f"target {i}": p for i, p in enumerate(position + self.rng.normal(0, 0.2, position.shape))}

    def move(self, command: np.ndarray) -> None:
        """Execute a command [m/s, rad/s] for one period, while the targets move too."""
        motion = self.problem.motion
        self.pose = np.asarray(self._move(self.pose, command))
        push = self.rng.multivariate_normal(np.zeros(len(motion.W)), motion.W, len(self.state))
        self.state = self.state @ np.asarray(motion.A).T + push

    def detect(self) -> dict[str, np.ndarray]:
        """Return the measured positions, in the body frame, of the targets in view."""
        position = self.state @ np.asarray(self.problem.motion.Z).T
        noisy = position + self.rng.multivariate_normal(
            np.zeros(position.shape[1]), self.problem.sensor.V, len(position)
        )
        seen, points_body = self._sees(self.pose, position), np.asarray(self._to_body(self.pose, noisy))
        return {f"target {i}": points_body[i] for i in np.flatnonzero(seen)}

    def in_world(self, point_body: np.ndarray) -> np.ndarray:
        """Transform a point from the robot's frame to the world [m] by its pose (yours comes from localisation)."""
        return np.asarray(self._to_world(self.pose, point_body))


def main() -> None:
    """Drive for a number of steps; print the detections and the largest position uncertainty at each."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("run", help="run folder of foveate train, or a preset")
    options.add_argument("--steps", type=int, default=60)
    options.add_argument("--speed", type=float, default=1.0, help="speed of the clock: 20 runs 20 times as fast")
    options.add_argument("--seed", type=int, default=0)
    given = options.parse_args()

    policy = foveate.load(given.run)
    problem = policy.problem
    robot, tracker = Robot(problem, given.seed), foveate.Tracker(problem, forget_after_s=30.0)
    for name, position in robot.rough_positions().items():
        tracker.add(name, position)
    robot.in_world(np.zeros(problem.agent.space.dimension))
    policy(tracker.belief().padded(MAX_TARGETS), robot.pose)  # compiles before the robot moves

    Z = np.asarray(problem.motion.Z)
    period, late = float(problem.tau) / given.speed, 0
    due = time.monotonic()
    for step in range(given.steps):
        dropped = tracker.predict()
        command = policy(tracker.belief().padded(MAX_TARGETS), robot.pose)
        robot.move(command)
        due += period
        late += time.monotonic() > due
        time.sleep(max(0.0, due - time.monotonic()))
        detections = {name: robot.in_world(point) for name, point in robot.detect().items()}
        seen = tracker.update(robot.pose, detections)
        std = np.sqrt(np.einsum("ij,njk,ik->n", Z, tracker.covariance, Z)).max(initial=0.0)
        numbers = ", ".join(f"{value:+.2f}" for value in command)
        line = f"step {step + 1}: command {numbers}; saw {len(seen.updated)} of {len(tracker.ids)}"
        known = f"least known to {std:.2f} m" if tracker.ids else "none left to follow"
        print(f"{line}, {known}" + f"; dropped {dropped}" * bool(dropped))
    print(f"{late} of {given.steps} steps were late; {sum(tracker.rejected.values())} detections rejected")


if __name__ == "__main__":
    main()
