"""A joint's run of readings at rest."""

from fss_arm_model.stillness import Run


def test_a_run_goes_on_while_all_readings_are_near_each_other():
    """A joint that creeps leaves it once it has gone the threshold in all, not in one step."""
    run = Run()
    assert not run.holds(0.0, 1.0)
    for t, q in enumerate([0.0, 0.4, 0.8, 1.0, 0.0]):
        run.add(t, q, 1.0)
    assert (run.start, run.last, run.moved, run.low, run.high) == (0, 4, -1, 0.0, 1.0)
    assert run.holds(0.5, 1.0)
    assert not run.holds(1.1, 1.0)
    run.add(5, 1.1, 1.0)
    assert (run.start, run.last, run.moved, run.low, run.high) == (5, 5, 4, 1.1, 1.1)
