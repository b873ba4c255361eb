"""Control loop with raw detections: no ids, some missed, some false, targets unknown in number.

    python examples/detections_loop.py best --steps 40

`Robot` is simulated: replace it by your own driver and detector. The detector gives a position in the robot's frame for
everything that it takes for a target.
"""

import argparse

import jax
import jax.numpy as jnp
import numpy as np

import foveate

BOX_M = 6.0
"""Targets are within this distance of the origin, on each axis, at the start."""
SETTINGS = foveate.DetectionSettings(
    low_m=(-BOX_M, -BOX_M),
    high_m=(BOX_M, BOX_M),
    cells=(12, 12),
    probability=0.9,
    clutter=0.2,
    undetected=4.0,
    tracks=16,
    detections=12,
)


class Robot:
    """Simulated robot in the plane: moves as commanded among wandering targets, and detects some of those in view."""

    def __init__(self, problem: foveate.Problem, seed: int) -> None:
        self.problem, self.rng = problem, np.random.default_rng(seed)
        self.pose = np.zeros(3)
        self.state = np.zeros((self.rng.poisson(SETTINGS.undetected), problem.motion.state_size))
        self.state[:, :2] = self.rng.uniform(-BOX_M, BOX_M, (len(self.state), 2))
        agent, space = problem.agent, problem.agent.space
        self._move = jax.jit(lambda pose, command: agent.move(pose, agent.action(command), problem.tau))
        self._to_body, self._to_world = jax.jit(space.to_body), jax.jit(space.to_world)
        self._sees = jax.jit(lambda points: problem.sensor.view.contains(points))

    def move(self, command: np.ndarray) -> None:
        """Execute a command [m/s, rad/s] for one period, while the targets move too."""
        motion = self.problem.motion
        self.pose = np.asarray(self._move(self.pose, command))
        push = self.rng.multivariate_normal(np.zeros(len(motion.W)), motion.W, len(self.state))
        self.state = self.state @ np.asarray(motion.A).T + push

    def detect(self) -> np.ndarray:
        """Return what the detector takes for targets: positions in the body frame, in any order."""
        position = self.state @ np.asarray(self.problem.motion.Z).T
        body = np.asarray(self._to_body(jnp.asarray(self.pose, float), jnp.asarray(position, float)))
        seen = np.asarray(self._sees(jnp.asarray(body, float))) & (
            self.rng.uniform(size=len(body)) < SETTINGS.probability
        )
        std = float(np.sqrt(self.problem.sensor.V[0, 0]))
        near = self.rng.uniform(-1.0, 1.0, (self.rng.poisson(SETTINGS.clutter), 2)) * float(
            self.problem.sensor.view.depth
        )
        false = near[np.asarray(self._sees(jnp.asarray(near, float)))]
        return self.rng.permutation(np.concatenate([body[seen] + self.rng.normal(0.0, std, (seen.sum(), 2)), false]))

    def in_world(self, points_body: np.ndarray) -> np.ndarray:
        """Transform points from the robot's frame to the world [m] by its pose (yours comes from localisation)."""
        return np.asarray(self._to_world(jnp.asarray(self.pose, float), jnp.asarray(points_body, float)))


def unseen_place(tracker: foveate.DetectionTracker, problem: foveate.Problem) -> foveate.Belief:
    """Return a belief at the likeliest place of a target never detected: for the policy one more target to look at."""
    cell = np.array(np.unravel_index(tracker.undetected.argmax(), SETTINGS.shape))
    low, high = np.array(SETTINGS.low_m), np.array(SETTINGS.high_m)
    mean = np.zeros((1, problem.motion.state_size))
    mean[0, :2] = low + (cell + 0.5) * (high - low) / SETTINGS.shape
    return foveate.Belief(mean, information=np.asarray(problem.prior_information))


def main() -> None:
    """Drive for a number of steps; print what is detected, confirmed and lost, and how many targets are expected."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("run", help="run folder of foveate train, or a preset, of a robot in the plane")
    options.add_argument("--steps", type=int, default=40)
    options.add_argument("--seed", type=int, default=0)
    given = options.parse_args()

    policy = foveate.load(given.run)
    robot = Robot(policy.problem, given.seed)
    tracker = foveate.DetectionTracker(policy.scenario, SETTINGS)
    for step in range(given.steps):
        tracker.predict()
        belief = tracker.belief()
        if belief.targets == 0:
            belief = unseen_place(tracker, policy.problem)
        robot.move(policy(belief, robot.pose))
        detections = robot.in_world(robot.detect())
        seen = tracker.update(robot.pose, detections)
        line = f"step {step + 1}: {len(detections)} detections, {len(tracker.ids)} targets"
        line += f"; confirmed {list(seen.confirmed)}" * bool(seen.confirmed) + f"; lost {list(seen.lost)}" * bool(
            seen.lost
        )
        print(f"{line}; {tracker.expected_number:.1f} expected, {tracker.undetected.sum():.1f} of them never seen")
    print(f"{len(robot.state)} targets were there; {tracker.overflow} tracks did not fit")


if __name__ == "__main__":
    main()
