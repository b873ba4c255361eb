"""Run one training on several devices and in several processes.

Every process runs the same program on the same numbers; only a batch of episodes is sharded (`gradient`). So each
process has the whole learner, and the first one saves it.
"""

import contextlib
import math
import os
import shutil
import tempfile
from collections.abc import Callable, Hashable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental import multihost_utils
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from foveate.errors import InputError

AXIS = "episodes"

HEARTBEAT_S = 20
"""Silence [s] after which a process is lost."""

QUOTA = Path("/sys/fs/cgroup/cpu.max")
"""A container's limit on Linux: processor time, or max, and its period, both in microseconds."""

MAX_LANES = 64
"""Most sums of micro-batches that are kept apart, and so the most cores that a training uses."""

T = TypeVar("T")
H = TypeVar("H", bound=Hashable)


class ProcessLost(Exception):
    """Another process of this training is gone."""


class Share(NamedTuple):
    """Part of a batch whose episodes have one shape: their number, the most at once on a device, the cost of one."""

    episodes: int
    micro_batch: int
    cost: float = 1.0


class Schedule(NamedTuple):
    """Micro-batches of every share, of `sizes` episodes each, on `devices`.

    `parts` has for each share the numbers of the micro-batches that each device works on, in order. The results of all
    with the same number in `lanes` (for each share, by micro-batch) are added where they are made.
    """

    devices: int
    sizes: tuple[int, ...]
    parts: tuple[tuple[tuple[int, ...], ...], ...]
    lanes: tuple[tuple[int, ...], ...]

    @property
    def lane_count(self) -> int:
        """Number of different lanes."""
        return 1 + max(lane for lanes in self.lanes for lane in lanes)


def use_cores() -> None:
    """On a CPU, make every core a device: the programs of a training are too small for two cores.

    Call it before JAX does anything; it has no effect later, or if JAX_NUM_CPU_DEVICES or XLA_FLAGS set the number.
    """
    configured = jax.config.values["jax_num_cpu_devices"] >= 0
    if not configured and "host_platform_device_count" not in os.environ.get("XLA_FLAGS", ""):
        with contextlib.suppress(RuntimeError):  # what JAX raises once it has started
            jax.config.update("jax_num_cpu_devices", cores())


def cores() -> int:
    """Number of cores that this process may use, by its affinity and its container's quota."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quota, _, period = QUOTA.read_text().partition(" ") if QUOTA.exists() else ("max", "", "")
    return count if quota == "max" else max(1, min(count, round(int(quota) / int(period))))


def schedule(shares: Sequence[Share]) -> Schedule:
    """Divide a batch into micro-batches, and these among the devices, so that all have nearly the same work.

    On one machine sizes and lanes do not depend on the number of cores: sums are the same on any.
    """
    devices, alone = jax.device_count(), jax.default_backend() == "cpu" and jax.process_count() == 1
    counts = [math.ceil(share.episodes / share.micro_batch) for share in shares]
    if not alone:  # the same work on each device
        counts = [devices * math.ceil(count / devices) for count in counts]
    work = {
        (i, part): math.ceil(share.episodes / count) * share.cost
        for i, (share, count) in enumerate(zip(shares, counts, strict=True))
        for part in range(count)
    }
    lanes = _balanced(work, min(len(work), MAX_LANES if alone else max(MAX_LANES, devices)))
    load = dict.fromkeys(range(1 + max(lanes.values())), 0.0)
    for part, lane in lanes.items():
        load[lane] += work[part]
    devices = min(devices, len(load))
    device_of = _balanced(load, devices)
    return Schedule(
        devices=devices,
        sizes=tuple(math.ceil(share.episodes / count) for share, count in zip(shares, counts, strict=True)),
        parts=tuple(
            tuple(
                tuple(part for part in range(count) if device_of[lanes[i, part]] == device) for device in range(devices)
            )
            for i, count in enumerate(counts)
        ),
        lanes=tuple(tuple(lanes[i, part] for part in range(count)) for i, count in enumerate(counts)),
    )


def _balanced(work: dict[H, float], bins: int) -> dict[H, int]:
    """Bin of each item, the largest first into the emptiest (Graham 1969)."""
    full, bin_of = [0.0] * bins, {}
    for item in sorted(work, key=lambda item: -work[item]):
        bin_of[item] = full.index(min(full))
        full[bin_of[item]] += work[item]
    return bin_of


def join(coordinator: str, processes: int | None, process_id: int | None) -> None:
    """Join a training of several processes, before anything else is done with JAX.

    `coordinator` is HOST:PORT of the first process, or "auto" to ask the cluster (SLURM, Kubernetes, MPI), which then
    knows the number of `processes` and the number of this one, from 0. Raises InputError if they cannot connect.
    """
    # Two devices per process hang on CPUs unless every step is waited for.
    jax.config.update("jax_num_cpu_devices", 1)
    address: dict[str, Any] = {}
    if coordinator != "auto":
        address = {"coordinator_address": coordinator, "num_processes": processes, "process_id": process_id}
    try:
        jax.distributed.initialize(**address, heartbeat_timeout_seconds=HEARTBEAT_S, initialization_timeout=120)
    except (RuntimeError, ValueError) as error:
        raise InputError(f"--coordinator {coordinator}: {str(error).splitlines()[0]}") from error


def mesh(devices: int) -> Mesh:
    """One axis of `devices`: the first ones of this machine, or all of all processes."""
    return jax.make_mesh((devices,), (AXIS,), axis_types=(AxisType.Auto,), devices=jax.devices()[:devices])


def on_all_devices(program: Callable[..., T], devices: int) -> Callable[..., T]:
    """Wrap a compiled program to run on all `devices`, with the same arguments in every process and local results.

    Calls raise ProcessLost if another process is gone.
    """
    if devices == 1:
        return program

    def run(*arguments: Any) -> T:
        try:
            results = program(*_replicated(arguments, mesh(devices)))
            return jax.block_until_ready(jax.tree.map(_local, results))
        except jax.errors.JaxRuntimeError as error:
            if jax.process_count() == 1:
                raise
            raise ProcessLost(f"another process of this training was lost: {str(error).splitlines()[0]}") from error

    return run


def _local(x: Any) -> Any:
    if not eqx.is_array(x):
        return x
    # The compiler may leave what the next call shards in its shards.
    return x.addressable_data(0) if x.is_fully_replicated else jnp.asarray(np.asarray(x))


def _replicated(tree: Any, mesh: Mesh) -> Any:
    sharding = NamedSharding(mesh, PartitionSpec())

    def put(x: Any) -> Any:
        if not eqx.is_array(x):
            return x
        if jnp.issubdtype(x.dtype, jax.dtypes.prng_key):
            return jax.random.wrap_key_data(put(jax.random.key_data(x)), impl=jax.random.key_impl(x))
        array = np.asarray(x)
        return jax.make_array_from_callback(array.shape, sharding, lambda part: array[part])

    return jax.tree.map(put, tree)


def from_first_process(*numbers: float) -> tuple[float, ...]:
    """Values of the first process; the others may have rounded differently."""
    if jax.process_count() == 1:
        return numbers
    # As integers: without x64 JAX would round float64 to float32.
    sent = multihost_utils.broadcast_one_to_all(np.array(numbers, np.float64).view(np.int32))
    return tuple(float(x) for x in np.asarray(sent).view(np.float64))


@contextlib.contextmanager
def folder_of_this_process(run: Path, resume: bool) -> Iterator[Path]:
    """The run folder in the first process; in others a temporary folder, with a copy of the run to resume."""
    if jax.process_index() == 0:
        yield run
        return
    with tempfile.TemporaryDirectory() as scratch:
        own = Path(scratch) / run.name
        if resume:
            shutil.copytree(run, own)
        yield own
