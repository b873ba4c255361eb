"""A scenario, and a recording that it is replayed in."""

import math

import pytest
from helpers.recordings import ANGLE, DEPTH, TAU

from foveate.recordings.formats import load_recording
from foveate.scenario.field_of_view import SectorView
from foveate.scenario.scenario import Scenario
from foveate.scenario.scenes import SceneSettings
from foveate.scenario.sensor import SensorSettings
from foveate.scenario.target import DriftTarget


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return Scenario(
        tau_s=TAU,
        view=SectorView(depth_m=DEPTH, angle_deg=ANGLE),
        sensor=SensorSettings(std_m=0.1),
        target=DriftTarget(process_std_m=0.5),
        scenes=SceneSettings(initial_error="consistent", targets_max=3, known_drift=False),
    )


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory):
    """a crosses the view, b stands behind the agent, c comes late and leaves, d has a gap of 5 s."""
    rows = []
    for k in range(81):
        t = 0.25 * k
        rows.append((t, "a", -8 + t, 1.1))
        rows.append((t, "b", -4.0, 0.5 * math.sin(t)))
        if 20 <= k <= 50:
            rows.append((t, "c", 3.0, 3 - 0.2 * t))
        if k <= 20 or k >= 40:
            rows.append((t, "d", 5.0, -1.0 + 0.05 * t))
    path = tmp_path_factory.mktemp("replay") / "r.csv"
    path.write_text("time_s,track_id,x_m,y_m\n" + "".join(f"{t},{i},{x},{y}\n" for t, i, x, y in rows))
    return load_recording(path)
