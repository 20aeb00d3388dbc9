"""All numbers of bags as a file for MATLAB: `bag_to_mat.py BAG [BAG...] FILE.mat`."""

import re
import sys
from collections import defaultdict
from dataclasses import fields, is_dataclass

import numpy as np
from scipy.io import savemat

from fss_arm_bags.reader import open_bags


def numbers(message, name=""):
    """The numbers and words in a message with the names of their fields: pose_position_x."""
    for field in fields(message):
        if field.name.isupper() or field.name == "__msgtype__":  # constants of the type
            continue
        path, value = f"{name}_{field.name}".lstrip("_"), getattr(message, field.name)
        if is_dataclass(value):  # a message in the message
            yield from numbers(value, path)
        elif not isinstance(value, list) or not any(map(is_dataclass, value)):
            yield path, np.asarray(value)


def column(values):
    """Of all messages: (messages) or (messages, elements); a cell for each if they differ."""
    if len({np.shape(value) for value in values}) == 1:
        return np.array(values)
    cells = np.empty(len(values), dtype=object)
    cells[:] = values
    return cells


def main(*paths):
    """One structure a topic, vicon_fss_fss; its field t is the stamp, or the receipt [s]."""
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
    savemat(file, tables, long_field_names=True, oned_as="column")
    for topic, rows in tables.items():
        print(f"{topic}: {len(rows['t'])} messages, {', '.join(rows)}")


if __name__ == "__main__":
    main(*sys.argv[1:])
