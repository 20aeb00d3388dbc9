"""Fixtures that the tests of calibrations share."""

from pathlib import Path

import pytest

from fss_arm_calib import causes


@pytest.fixture(autouse=True)
def no_search(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Why a calibration fails, tens of others tell: with --slow, and where that is tested."""
    if not request.config.getoption("--slow") and Path(request.path).name != "test_causes.py":
        monkeypatch.setattr(causes, "MAX_SEARCH_TIME", -1.0)
