"""Data of a calibration from bags, found in the same way as in its node."""

from collections.abc import Sequence
from typing import TypeVar

from fss_arm_bags.bulk import batches
from fss_arm_bags.reader import Bags
from fss_arm_bags.streams import find_topic
from fss_arm_calib.calibration import Finder, Input
from fss_arm_calib.segments.streams import Datum
from fss_arm_ros.convert import SECOND

D = TypeVar("D", bound=Datum)

CHUNK = 0.2  # length of what is read at once, relative to the horizon (largest lag of a stream)


def find_data(
    bags: Bags, finder: Finder[D], inputs: Sequence[Input], horizon: float, namespace: str = ""
) -> list[D]:
    """Feed the messages of the bags to a finder and return the data that it finds."""
    topics = {topic_name(bags, one, namespace): one for one in inputs}
    found: list[D] = []
    for piece in batches(bags.raw(set(topics)), round(CHUNK * horizon * SECOND)):
        for topic, one in topics.items():
            data = piece.get(topic, [])
            if one.bulk:
                found += one.bulk(finder, data)
                continue
            for message in data:
                found += one.feed(finder, bags.deserialize(message, one.type))
    return found + finder.close()


def topic_name(bags: Bags, one: Input, namespace: str = "", needed: bool = True) -> str:
    """Return the full name of an input's topic in the bags; errors are those of `find_topic`."""
    return find_topic(bags, one.topic, one.type, namespace, needed and one.needed, one.option)
