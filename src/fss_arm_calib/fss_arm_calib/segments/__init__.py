"""Segments of streams: where the arm rested, moved and drifted.

| to change | see |
|---|---|
| when a joint counts as at rest | `fss_arm_model.stillness` |
| how joints are merged by stamp, and when all of them rest | `joints.py` |
| the steps from samples to a segment | `finder.py` |
| when all streams have passed a moment; clocks; forgetting | `sensors.py` |
| what of a rest becomes an observation | `rests.py` |
| what of two rests becomes a maneuver | `maneuvers.py` |
| what of a rest becomes a drift | `drifts.py` |
| which samples are rejected | `samples.py`, `poses.py`, `gyro.py`, `telemetry.py` |
| the numbers of it all | `settings.py` |
"""
