"""Work of `foveate render`."""

from foveate.cli.common import check_output, policy_named
from foveate.cli.render import Render
from foveate.plotting.render import render


def run(options: Render) -> int:
    """Simulate the scenes, draw them, print what was written."""
    check_output(options.out, options.scenes)
    drawn = render(
        policy_named(options.run),
        options.out,
        options.scenes,
        scene=options.scene,
        method=options.method,
        protocol=options.protocol,
        seed=options.seed,
        scene_seed=options.scene_seed,
        width=options.width,
        dpi=options.dpi,
    )
    print(f"{options.out}: {', '.join(drawn)}")
    return 0
