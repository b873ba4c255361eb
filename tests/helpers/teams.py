"""What the robots of a team know, by gossip and textbook filters in numpy."""

import numpy as np


def known_measurements(trace, delay):
    """Sets of (step, source) that each robot has heard of after each step, by gossip."""
    K, M, _ = trace.team.heard.shape
    known, sent, after = [set() for _ in range(M)], [], []
    for k in range(K):
        known = [own | {(k, m)} for m, own in enumerate(known)]
        nobody = np.zeros((M, M), bool), known
        heard, senders = (trace.team.heard[k], known) if delay == 0 else sent[k - delay] if k >= delay else nobody
        known = [known[i].union(*(senders[j] for j in range(M) if heard[i, j])) for i in range(M)]
        sent.append((trace.team.heard[k], list(known)))
        after.append(list(known))
    return after


def kalman(problem, episode, trace, measured, last, target, noises=None):
    """Textbook filter of one target, of the measurements (step, source) up to a step: mean and covariance.

    `noises` are the covariances of every robot's measurements, where they differ.
    """
    A, W, H = (np.asarray(x) for x in (problem.motion.A, problem.motion.W, problem.sensor.H))
    mean, P = np.asarray(episode.mean[target]), np.linalg.inv(problem.prior_information)
    for k in range(last + 1):
        mean, P = A @ mean, A @ P @ A.T + W
        for m in sorted(source for step, source in measured if step == k):
            if not trace.team.visible[k, m, target]:
                continue
            z, V = measurement(problem, episode, trace, k, m, target, noises and noises[m])
            gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + V)
            mean, P = mean + gain @ (z - H @ mean), P - gain @ H @ P
    return mean, P


def measurement(problem, episode, trace, k, m, target, V=None):
    """What robot m measures in step k, and its covariance."""
    state = episode.truth.state[k + 1, target]
    own = episode.truth.measurement_noise[k, target] if m == 0 else episode.team.measurement_noise[k, m - 1, target]
    V = np.asarray(problem.sensor.V if V is None else V)
    return problem.sensor.H @ state + np.linalg.cholesky(V) @ own, V
