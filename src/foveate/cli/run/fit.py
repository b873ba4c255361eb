"""Work of `foveate fit`."""

from foveate import api
from foveate.cli.common import check_output
from foveate.cli.fit import Fit
from foveate.errors import InputError


def run(options: Fit) -> int:
    """Fit, print the statistics, write the experiment."""
    check_output(options.out, options.recording)
    if options.out.exists():
        raise InputError(f"{options.out}: exists already: choose another --out")
    fitted = api.fit(
        options.recording,
        start=options.start,
        end=options.end,
        max_gap=options.max_gap,
        v_max=options.v_max,
        w_max=options.w_max,
        view_depth=options.view_depth,
        view_angle_deg=options.view_angle_deg,
        tau=options.tau,
        sensor_std_m=options.sensor_std_m,
        goal=options.goal,
    )
    print(fitted)
    fitted.save(options.out)
    print(f"{options.out}: written; next  foveate train --config {options.out}")
    return 0
