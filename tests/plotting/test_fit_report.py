"""The page about a fit."""

import base64
import re
from io import BytesIO

import numpy as np
from helpers.recordings import recording, track
from PIL import Image

from foveate.plotting.fit_report import write_fit_report
from foveate.recordings.fit import fit


def test_the_page_holds_facts_findings_and_a_figure(tmp_path):
    times = 0.25 * np.arange(200)
    positions = np.stack([times, 0.5 * times], axis=1)
    positions[50] += 20.0
    positions[120:] += 40.0
    made = recording(track(times, positions, "a <b>"), track([3.0], [[1.0, 1.0]], "once"))
    write_fit_report(fit(made), tmp_path / "r.html")
    page = (tmp_path / "r.html").read_text()
    for said in (
        "a &lt;b&gt;: 1 fix is out and back (the first at 12.5 s)",
        "jumps by 57 m at 30 s",
        "once: a single fix",
    ):
        assert page.count(said) == 1, said
    assert "speed median 1.12" in page
    (data,) = re.findall(r"base64,([^\"]+)", page)
    image = np.asarray(Image.open(BytesIO(base64.b64decode(data))).convert("RGB"))
    assert image.shape[0] > 300
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 20
    clean = recording(track(times, np.stack([times, 0.5 * times], axis=1)))
    write_fit_report(fit(clean), tmp_path / "clean.html")
    assert "Nothing: every fix counts." in (tmp_path / "clean.html").read_text()
