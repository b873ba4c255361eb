"""Networks of `policies/` as ONNX nodes: from a pose and predicted beliefs to the action before its tanh."""

import numpy as np
from onnx import TensorProto

from foveate.deploy.onnx.graph import Graph, body_inputs, features, logarithm, only_present, packed
from foveate.policies.attention import AttentionPolicy
from foveate.policies.inputs import FINAL_STEPS, MAX_STEPS_LEFT, MIN_RANGE_M, STEPS_LEFT_UNIT, TARGETS_UNIT
from foveate.policies.pointer import PADDING_LOG_WEIGHT, PointerPolicy, SetEncoder


def attention(graph: Graph, policy: AttentionPolicy, state_size: int) -> str:
    """Nodes of `AttentionPolicy`, up to its tanh."""
    if policy.frame == "world":
        agent, mean = logarithm(graph, policy.space), "mean"
        information = packed(graph, "information", state_size)
    else:
        # A constant: the runtime folds all that depends on it alone when it loads the graph.
        agent = graph.constant(np.zeros((1, policy.space.twist_size)))
        mean, information, _ = body_inputs(graph, policy.space, state_size)
    targets = features(graph, mean, information, policy.length_m, policy.information)
    agent, targets = graph.relu_layers(agent, policy.agent_layers), graph.relu_layers(targets, policy.target_layers)
    query = graph("Unsqueeze", graph("Div", agent, policy.alpha), [1])
    scores = graph("MatMul", query, graph("Transpose", targets, perm=[0, 2, 1]))
    context = graph("Relu", graph("Squeeze", graph.softmax_mean(targets, scores), [1]))
    first, *rest = policy.out_layers
    weight, size = np.asarray(first.weight).T, np.asarray(policy.target_layers[-1].bias).size
    # A first layer on [context, agent] is the sum of one on each: in the body frame the agent's part is constant.
    by_agent = graph("Add", graph("MatMul", agent, weight[size:]), np.asarray(first.bias))
    hidden = graph("Add", graph("MatMul", context, weight[:size]), by_agent)
    for layer in rest:
        hidden = graph.dense(graph("Relu", hidden), layer)
    return hidden


def set_encoder(graph: Graph, network: SetEncoder, state_size: int, input_size: int) -> tuple[str, str]:
    """Nodes of `SetEncoder`: embeddings of the targets (b, n, e), and their means by h attention queries (b, h e)."""
    d = network.space.dimension
    mean, information, rotation = body_inputs(graph, network.space, state_size)
    position = graph("Slice", mean, [0], [d], [2])
    square = graph("ReduceSum", graph("Mul", position, position), [2])
    distance = graph("Sqrt", graph("Add", square, MIN_RANGE_M**2))
    # The order of these inputs is that of `policies.inputs.pointer_features`.
    own_inputs = [features(graph, mean, information, network.length_m, "asinh")]
    own_inputs += [only_present(graph, x) for x in (graph("Div", position, distance), graph("Log", distance))]
    if input_size == d:
        own_inputs.append(only_present(graph, graph("MatMul", "known_input", rotation)))
    left = graph("Max", graph("Cast", graph("Unsqueeze", "steps_left", [1]), to=TensorProto.FLOAT), 0.0)
    count = graph("ReduceSum", graph("Cast", "present", to=TensorProto.FLOAT), [1])
    horizon = graph("Min", graph("Div", left, STEPS_LEFT_UNIT), MAX_STEPS_LEFT)
    final = graph("Exp", graph("Div", left, -FINAL_STEPS))
    common = graph("Concat", horizon, final, graph("Div", count, TARGETS_UNIT), axis=1)
    # The three `common` inputs are in the middle of a target's: their part of the first layer is computed once for all.
    first, *rest = network.target_layers
    weight = np.asarray(first.weight).T
    begin = state_size + state_size * (state_size + 1) // 2 + d + 1
    own = np.concatenate([weight[:begin], weight[begin + 3 :]])
    shared = graph("Add", graph("MatMul", common, weight[begin : begin + 3]), np.asarray(first.bias))
    hidden = graph("MatMul", graph("Concat", *own_inputs, axis=2), own)
    targets = graph.relu_layers(graph("Relu", graph("Add", hidden, graph("Unsqueeze", shared, [1]))), rest)
    (query,) = network.query_layers
    scores = graph("Transpose", graph.dense(targets, query), perm=[0, 2, 1])
    size = np.asarray(query.bias).size * np.asarray(network.target_layers[-1].bias).size
    return targets, graph("Reshape", graph.softmax_mean(targets, scores), [-1, size])


def pointer(graph: Graph, policy: PointerPolicy, state_size: int, input_size: int) -> str:
    """Nodes of `PointerPolicy`, up to its tanh: the numbers of the mode with the largest weight."""
    targets, attended = set_encoder(graph, policy.encoder, state_size, input_size)
    context = graph.relu_layers(attended, policy.context_layers)
    first, *between, last = policy.mode_layers
    weight, size = np.asarray(first.weight).T, np.asarray(policy.encoder.target_layers[-1].bias).size
    # A first layer on [target, context] is the sum of one on each: the context's part is the same for all targets.
    by_context = graph("Add", graph("MatMul", context, weight[size:]), np.asarray(first.bias))
    hidden = graph("Add", graph("MatMul", targets, weight[:size]), graph("Unsqueeze", by_context, [1]))
    numbers = graph.dense(graph.relu_layers(graph("Relu", hidden), between), last)
    per_mode = np.asarray(last.bias).size // policy.per_target
    numbers = graph("Reshape", numbers, [0, 0, policy.per_target, per_mode])
    present = graph("Unsqueeze", "present", [2])
    log_weight = graph("Squeeze", graph("Slice", numbers, [0], [1], [3]), [3])
    log_weight = graph("Where", present, log_weight, PADDING_LOG_WEIGHT)
    actions = graph("Reshape", graph("Slice", numbers, [1], [per_mode], [3]), [0, -1, per_mode - 1])
    (idle_layer,) = policy.idle_layers
    idle = graph.dense(context, idle_layer)
    log_weight = graph("Concat", graph("Reshape", log_weight, [0, -1]), graph("Slice", idle, [0], [1], [1]), axis=1)
    idle = graph("Unsqueeze", graph("Slice", idle, [1], [per_mode], [1]), [1])
    best = graph("ArgMax", log_weight, axis=1, keepdims=1)
    return graph("GatherND", graph("Concat", actions, idle, axis=1), best, batch_dims=1)
