"""The policy that a training begins with: random weights, or those of a run or a preset."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from foveate.experiment.experiment import Experiment
from foveate.experiment.resolve import load
from foveate.io.validate import require
from foveate.policies.pointer import NO_LIMIT, PointerPolicy
from foveate.policies.tokens import WINDOW_FEATURES
from foveate.simulation.records import Policy
from foveate.types import Key


def first_policy(experiment: Experiment, key: Key) -> Policy:
    """The policy that a training begins with. Raises InputError if the run of its first weights has another network.

    A network with the dynamic window may begin with the weights of one without it.
    """
    policy = experiment.new_policy(key)
    if experiment.begins_with is None:
        return policy
    given, (arrays, static) = load(experiment.begins_with)[1], eqx.partition(policy, eqx.is_array)
    if isinstance(given, PointerPolicy) and isinstance(policy, PointerPolicy):
        given = with_window(given, policy)
    weights = jax.tree.leaves(eqx.filter(given, eqx.is_array))
    fits = [x.shape for x in weights] == [x.shape for x in jax.tree.leaves(arrays)]
    right = (
        "expected a run with a network of this shape: of the scenario's space, of a team (of a single robot with "
        "policy.assignment), with the sizes, rays and clips_features of policy, and a dynamic window only as policy has"
    )
    require(fits, "policy.begin_with", experiment.begins_with, right)
    return eqx.combine(jax.tree.unflatten(jax.tree.structure(arrays), weights), static)


def with_window(policy: PointerPolicy, new: PointerPolicy) -> PointerPolicy:
    """The weights of a network without the dynamic window, with those of `new` for it, if their contexts are as wide.

    What the window expects counts nothing at first, and its command has the weight of one that does not aim.
    """
    adds_window = new.window_log_weight is not None and policy.window_log_weight is None
    if not adds_window or policy.idle_layer.weight.shape[1] != new.idle_layer.weight.shape[1]:
        return policy
    first, size = policy.encoder.target_layers[0], len(policy.idle_layer.weight)
    idle = [jax.tree.leaves(each.idle_layer) for each in (policy, new)]  # weight and bias

    unused: Float[Array, "width features"] = jnp.zeros((len(first.weight), WINDOW_FEATURES), first.weight.dtype)
    policy = eqx.tree_at(
        lambda each: (each.encoder.target_layers[0].weight, *jax.tree.leaves(each.idle_layer)),
        policy,
        (
            jnp.concatenate([unused, first.weight], axis=1),
            *(jnp.concatenate([old, more[size:]]) for old, more in zip(*idle, strict=True)),
        ),
    )
    limits = policy.feature_range
    if limits is not None:
        free = jnp.array([[-NO_LIMIT], [NO_LIMIT]], limits.dtype) + jnp.zeros(WINDOW_FEATURES, limits.dtype)
        limits = jnp.concatenate([free, limits], axis=1)
    return replace(policy, window_log_weight=new.window_log_weight, feature_range=limits)
