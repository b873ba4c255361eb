"""Work of `foveate fit`."""

from foveate import api
from foveate.cli.fit import Fit
from foveate.plotting.fit_report import write_fit_report
from foveate.recordings.formats import load_recording


def run(options: Fit) -> int:
    """Fit, print the statistics, write the experiment."""
    recording = load_recording(options.recording, **options.reading())
    fitted = api.fit(
        recording,
        start=options.start,
        end=options.end,
        split=options.split,
        max_gap=options.max_gap,
        max_speed=options.max_speed,
        v_max=options.v_max,
        w_max=options.w_max,
        view_depth=options.view_depth,
        view_angle_deg=options.view_angle_deg,
        tau=options.tau,
        sensor_std_m=options.sensor_std_m,
        goal=options.goal,
        map=options.map,
    )
    print(fitted)
    fitted.save(options.out)
    if options.report is not None:
        write_fit_report(fitted, options.report, options.max_speed)
        print(f"{options.report}: the report")
    print(f"{options.out}: written; next  foveate train --config {options.out}")
    print("which ends with a verdict: the policy beside every heuristic and a planner")
    return 0
