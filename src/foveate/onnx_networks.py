"""The networks of `policies/` as ONNX nodes: from a pose and predicted beliefs to what tanh turns into an action."""

import numpy as np
from onnx import TensorProto

from foveate.onnx_graph import Graph, body_inputs, features, logarithm, only_present, packed
from foveate.policies.attention import AttentionPolicy
from foveate.policies.pooling import HORIZON_STEPS, LAST_STEPS, LEAST_RANGE_M, MOST_UNITS, USUAL_TARGETS, PoolingPolicy


def attention(graph: Graph, policy: AttentionPolicy, state_size: int) -> str:
    """Nodes of `AttentionPolicy`, up to its tanh."""
    if policy.frame == "world":
        agent, mean = logarithm(graph, policy.space), "mean"
        information = packed(graph, "information", state_size)
    else:
        # A constant: the runtime computes all that follows from it alone when it loads the graph.
        agent = graph.constant(np.zeros((1, policy.space.twist_size)))
        mean, information, _ = body_inputs(graph, policy.space, state_size)
    targets = features(graph, mean, information, policy.length_m, policy.information)
    agent, targets = graph.chain(agent, policy.agent_layers), graph.chain(targets, policy.target_layers)
    query = graph("Unsqueeze", graph("Div", agent, policy.alpha), [1])
    scores = graph("MatMul", query, graph("Transpose", targets, perm=[0, 2, 1]))
    context = graph("Relu", graph("Squeeze", graph.gathered(targets, scores), [1]))
    first, *rest = policy.out_layers
    weight, size = np.asarray(first.weight).T, np.asarray(policy.target_layers[-1].bias).size
    told = graph("Add", graph("MatMul", agent, weight[size:]), np.asarray(first.bias))
    hidden = graph("Add", graph("MatMul", context, weight[:size]), told)
    for layer in rest:
        hidden = graph.dense(graph("Relu", hidden), layer)
    return hidden


def pooling(graph: Graph, policy: PoolingPolicy, state_size: int, input_size: int) -> str:
    """Nodes of `PoolingPolicy`, up to its tanh."""
    d = policy.space.dimension
    mean, information, turn = body_inputs(graph, policy.space, state_size)
    position = graph("Slice", mean, [0], [d], [2])
    square = graph("ReduceSum", graph("Mul", position, position), [2])
    distance = graph("Sqrt", graph("Add", square, LEAST_RANGE_M**2))
    known = [features(graph, mean, information, policy.length_m, "asinh")]
    known += [only_present(graph, x) for x in (graph("Div", position, distance), graph("Log", distance))]
    if input_size == d:
        known.append(only_present(graph, graph("MatMul", "known_input", turn)))
    left = graph("Max", graph("Cast", graph("Unsqueeze", "steps_left", [1]), to=TensorProto.FLOAT), 0.0)
    count = graph("ReduceSum", graph("Cast", "present", to=TensorProto.FLOAT), [1])
    common = graph(
        "Concat",
        graph("Min", graph("Div", left, HORIZON_STEPS), MOST_UNITS),
        graph("Exp", graph("Div", left, -LAST_STEPS)),
        graph("Div", count, USUAL_TARGETS),
        axis=1,
    )
    first, *rest = policy.target_layers
    weight = np.asarray(first.weight).T
    begin = state_size + state_size * (state_size + 1) // 2 + d + 1
    own = np.concatenate([weight[:begin], weight[begin + 3 :]])
    shared = graph("Add", graph("MatMul", common, weight[begin : begin + 3]), np.asarray(first.bias))
    hidden = graph("MatMul", graph("Concat", *known, axis=2), own)
    targets = graph.chain(graph("Relu", graph("Add", hidden, graph("Unsqueeze", shared, [1]))), rest)
    (query,) = policy.query_layers
    scores = graph("Transpose", graph.dense(targets, query), perm=[0, 2, 1])
    size = np.asarray(query.bias).size * np.asarray(policy.target_layers[-1].bias).size
    gathered = graph("Reshape", graph.gathered(targets, scores), [-1, size])
    *between, last = policy.out_layers
    return graph.dense(graph.chain(gathered, between), last)
