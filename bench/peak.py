"""What one core can do at most: multiplications and additions that wait for nothing."""

from time import process_time

import numba
import numpy as np

ROWS, TIMES = 96, 4000  # numbers that go on independently of each other, which fill the registers
PEAK_OPERATIONS = 16 * ROWS * TIMES


@numba.njit(error_model="numpy")
def _multiply_and_add(a, b):
    x = np.full(ROWS, a)
    for _ in range(TIMES):
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
    """Multiplications and additions a second, the best of several runs."""
    multiply_and_add()
    took = []
    for _ in range(10):
        begin = process_time()
        multiply_and_add()
        took.append(process_time() - begin)
    return PEAK_OPERATIONS / min(took)
