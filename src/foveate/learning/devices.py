"""One training on several devices and in several processes: who has which arrays, and what happens if one is lost.

Every process runs the same program on the same numbers; only a batch of episodes is shared out (`gradient`). So all
of them know all of the learner, and one of them writes it down.
"""

import contextlib
import math
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
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
"""A process that was silent for so long [s] is lost."""


QUOTA = Path("/sys/fs/cgroup/cpu.max")
"""Where Linux says how much of its cores a container may use: microseconds, or max, in so many."""


T = TypeVar("T")


class ProcessLost(Exception):
    """Another process of this training is gone."""


class Sharding(NamedTuple):
    """How a batch is shared out: `rounds` in turn, in each of them `size` episodes on each of so many devices."""

    devices: int
    rounds: int
    size: int


def use_cores() -> None:
    """On a CPU, let every core be a device of its own: a training's programs are too small to be shared by two.

    To be called before JAX does anything; without effect later. Whoever has said how many devices there are
    (JAX_NUM_CPU_DEVICES, or in XLA_FLAGS) is not overruled.
    """
    said = jax.config.values["jax_num_cpu_devices"] >= 0
    if not said and "host_platform_device_count" not in os.environ.get("XLA_FLAGS", ""):
        with contextlib.suppress(RuntimeError):  # JAX's word for "later"
            jax.config.update("jax_num_cpu_devices", cores())


def cores() -> int:
    """How many cores this process may use."""
    count = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    quota, _, period = QUOTA.read_text().partition(" ") if QUOTA.exists() else ("max", "", "")
    return count if quota == "max" else max(1, min(count, round(int(quota) / int(period))))


def sharded(episodes: int, micro_batch: int) -> Sharding:
    """How a batch is shared out, at most `micro_batch` episodes at once on a device.

    On the cores of one machine no number of episodes depends on how many cores there are, so that sums do not, either.
    """
    devices = jax.device_count()
    if jax.default_backend() == "cpu" and jax.process_count() == 1:
        parts = math.ceil(episodes / micro_batch)
        devices = min(devices, parts)
        return Sharding(devices, math.ceil(parts / devices), math.ceil(episodes / parts))
    share = math.ceil(episodes / devices)
    rounds = math.ceil(share / micro_batch)
    return Sharding(devices, rounds, math.ceil(share / rounds))


def join(coordinator: str, processes: int | None, process_id: int | None) -> None:
    """Become one of several processes; before anything else is done with JAX. One device a process on CPUs.

    `coordinator` is HOST:PORT of the first process; "auto" asks the cluster (SLURM, Kubernetes, MPI), and needs no
    numbers. Raises ValueError where they cannot find each other.
    """
    jax.config.update("jax_num_cpu_devices", 1)
    given: dict[str, Any] = {}
    if coordinator != "auto":
        given = {"coordinator_address": coordinator, "num_processes": processes, "process_id": process_id}
    try:
        jax.distributed.initialize(**given, heartbeat_timeout_seconds=HEARTBEAT_S, initialization_timeout=120)
    except (RuntimeError, ValueError) as error:
        raise InputError(f"--coordinator {coordinator}: {str(error).splitlines()[0]}") from error


def mesh(devices: int) -> Mesh:
    """So many devices in a row: the first of this machine, or all of all processes."""
    return jax.make_mesh((devices,), (AXIS,), axis_types=(AxisType.Auto,), devices=jax.devices()[:devices])


def on_all_devices(program: Callable[..., T], devices: int) -> Callable[..., T]:
    """A compiled program whose arguments, the same in every process, are put on so many devices, and whose results
    are taken from one of this process. The program itself where there is but one device.

    Raises ProcessLost where another process is gone.
    """
    if devices == 1:
        return program

    def run(*arguments: Any) -> T:
        try:
            return jax.block_until_ready(_here(program(*_everywhere(arguments, mesh(devices)))))
        except jax.errors.JaxRuntimeError as error:
            if jax.process_count() == 1:
                raise
            raise ProcessLost(f"another process of this training was lost: {str(error).splitlines()[0]}") from error

    return run


def _everywhere(tree: Any, mesh: Mesh) -> Any:
    place = NamedSharding(mesh, PartitionSpec())

    def put(x: Any) -> Any:
        if not eqx.is_array(x):
            return x
        if jnp.issubdtype(x.dtype, jax.dtypes.prng_key):
            return jax.random.wrap_key_data(put(jax.random.key_data(x)), impl=jax.random.key_impl(x))
        known = np.asarray(x)
        return jax.make_array_from_callback(known.shape, place, lambda part: known[part])

    return jax.tree.map(put, tree)


def _here(tree: Any) -> Any:
    return jax.tree.map(lambda x: x.addressable_data(0) if eqx.is_array(x) else x, tree)


def agreed(*numbers: float) -> tuple[float, ...]:
    """What the first process says of numbers that others may have rounded otherwise."""
    if jax.process_count() == 1:
        return numbers
    told = multihost_utils.broadcast_one_to_all(np.array(numbers, np.float64).view(np.int32))
    return tuple(float(x) for x in np.asarray(told).view(np.float64))


@contextlib.contextmanager
def folder_of_this_process(run: Path, resume: bool) -> Iterator[Path]:
    """The run folder in the first process. In others a folder that is thrown away, a copy of it to go on from."""
    if jax.process_index() == 0:
        yield run
        return
    with tempfile.TemporaryDirectory() as scratch:
        own = Path(scratch) / run.name
        if resume:
            shutil.copytree(run, own)
        yield own
