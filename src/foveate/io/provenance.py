"""Provenance of results, part of every file of results."""

import jax

from foveate import __version__


def provenance() -> dict[str, str]:
    """Versions, device and precision of this process."""
    devices = jax.devices()
    return {
        "foveate": __version__,
        "jax": jax.__version__,
        "device": f"{len(devices)} {devices[0].platform} ({devices[0].device_kind})",
        "precision": "float64" if jax.config.read("jax_enable_x64") else "float32",
    }
