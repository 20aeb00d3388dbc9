"""Write all numbers of bags to a file for MATLAB: `bag_to_mat.py BAG [BAG...] FILE.mat`."""

import re
import sys
from collections import defaultdict
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np
from scipy.io import savemat

from fss_arm_bags.reader import BagError, open_bags


def numbers(message, name=""):
    """Yield the field names, such as pose_position_x, and values of a message."""
    for field in fields(message):
        if field.name.isupper() or field.name == "__msgtype__":  # constants of the type
            continue
        path, value = f"{name}_{field.name}".lstrip("_"), getattr(message, field.name)
        if is_dataclass(value):  # a message in the message
            yield from numbers(value, path)
        elif not isinstance(value, list) or not any(map(is_dataclass, value)):
            yield path, np.asarray(value)


def column(values):
    """Return an array (messages) or (messages, elements); one of cells if the shapes differ."""
    if len({np.shape(value) for value in values}) == 1:
        return np.array(values)
    cells = np.empty(len(values), dtype=object)
    cells[:] = values
    return cells


def main(*paths):
    """Write a structure for each topic; its field t is the stamp, or the time of receipt [s]."""
    *bags, file = paths
    found = defaultdict(lambda: defaultdict(list))
    with open_bags(bags) as opened:
        for topic, _, receipt, message in opened.messages():
            rows = found[re.sub(r"\W+", "_", topic).strip("_")[:63]]
            stamp = getattr(getattr(message, "header", None), "stamp", None)
            rows["t"].append(stamp.sec + 1e-9 * stamp.nanosec if stamp else 1e-9 * receipt)
            for name, value in numbers(message):
                rows[name.removeprefix("header_")[-63:]].append(value)
    tables = {
        topic: {name.lstrip("_"): column(values) for name, values in rows.items()}
        for topic, rows in found.items()
    }
    Path(file).parent.mkdir(parents=True, exist_ok=True)
    savemat(file, tables, long_field_names=True, oned_as="column")
    for topic, rows in tables.items():
        print(f"{topic}: {len(rows['t'])} messages, {', '.join(rows)}")


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except BagError as error:
        sys.exit(f"bag_to_mat.py: {error}")
