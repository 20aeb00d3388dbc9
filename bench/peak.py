"""Peak rate of one core: multiplications and additions that never wait."""

from time import process_time

import numba
import numpy as np

ROWS, REPETITIONS = 96, 4000  # independent numbers, which fill the registers; repetitions
PEAK_OPERATIONS = 16 * ROWS * REPETITIONS


@numba.njit(error_model="numpy")
def _multiply_and_add(a, b):
    x = np.full(ROWS, a)
    for _ in range(REPETITIONS):
        for j in range(ROWS):
            y = x[j] * a + b
            y = y * a + b
            y = y * a + b
            y = y * a + b
            y = y * a + b
            y = y * a + b
            y = y * a + b
            x[j] = y * a + b
    return x.sum()


def multiply_and_add():
    _multiply_and_add(0.5, 0.1)


def peak() -> float:
    """Return the multiplications and additions per second, the best of several runs."""
    multiply_and_add()
    times = []
    for _ in range(10):
        start = process_time()
        multiply_and_add()
        times.append(process_time() - start)
    return PEAK_OPERATIONS / min(times)
