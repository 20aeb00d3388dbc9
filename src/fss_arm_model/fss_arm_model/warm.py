"""`python -m fss_arm_model.warm`: compile every kernel into the cache, or find it there.

The set-up runs this once, so that no node compiles at its start.
"""

import pkgutil
import sys
import time
from importlib import import_module

import fss_arm_model

from . import _cache


def warm() -> int:
    """Load every kernel of the package; return how many there are."""
    for module in pkgutil.iter_modules(fss_arm_model.__path__):
        if module.name != "warm":
            import_module(f"fss_arm_model.{module.name}")
    for kernel in _cache.KERNELS:
        _ = kernel.compiled
    return len(_cache.KERNELS)


def main() -> int:
    """Warm the cache and say what was done."""
    folder = _cache.cache_folder()
    if not _cache.CACHED:
        print(f"cannot write to {folder}, expected a folder: set NUMBA_CACHE_DIR", file=sys.stderr)
        return 1
    begin = time.perf_counter()
    count = warm()
    print(f"{count} kernels ready in {time.perf_counter() - begin:.1f} s, kept in {folder}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
