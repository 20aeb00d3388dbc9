"""`python -m fss_arm_model.warm`: compile every kernel into the cache, or load it from there.

The set-up runs this once, so that no node compiles kernels when it starts.
"""

import pkgutil
import sys
import time
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

from .kernels import KERNELS, cache_lock


def modules() -> Iterator[str]:
    """Yield the modules that define kernels, in all packages of the workspace on Python's path."""
    package: Any
    for package in pkgutil.iter_modules():
        if package.ispkg and package.name.startswith("fss_"):
            root = Path(package.module_finder.path)
            for source in sorted((root / package.name).rglob("*.py")):
                if "\n@kernel(" in source.read_text(encoding="utf-8"):
                    yield ".".join(source.relative_to(root).with_suffix("").parts)


def main() -> int:
    """Load every kernel, and print the result."""
    start = time.perf_counter()
    for module in modules():
        import_module(module)
    for folder in {kernel.folder for kernel in KERNELS}:
        with cache_lock(folder) as writable:
            if not writable:
                print(f"cannot write to {folder}: set NUMBA_CACHE_DIR to a folder", file=sys.stderr)
                return 1
    for kernel in KERNELS:
        _ = kernel.compiled
    took = time.perf_counter() - start
    print(f"{len(KERNELS)} kernels ready in {took:.1f} s, stored in {KERNELS[0].folder.parent}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
